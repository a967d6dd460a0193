"""The file in an FMU's resources that holds its defaults: one `name = value` a line, every bit kept.

The FMU reads its start values from there when it is instantiated, so changing the file and modelDescription.xml alike
changes what the FMU does in every tool.
"""

from collections.abc import Mapping

RESOURCE = "resources/defaults.txt"


def dump(values: Mapping[str, float]) -> str:
    """The lines for these values, in their order."""
    return "".join(f"{name} = {value!r}\n" for name, value in values.items())


def load(text: str) -> dict[str, float]:
    """Values by name: bool for True and False, int without a decimal point or exponent, else float."""
    values: dict[str, float] = {}
    for line in text.splitlines():
        name, separator, number = (part.strip() for part in line.partition("="))
        if not separator:
            continue
        values[name] = _number(number)
    return values


def _number(text: str) -> float:
    if text in ("True", "False"):
        return text == "True"
    return int(text) if text.lstrip("+-").isdigit() else float(text)

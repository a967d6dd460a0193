"""FMUs as people meet them."""

from __future__ import annotations

from tests.support.cases.case import Case, Step

_BUILD = Step("python build.py")
_LAST = "python -c \"import pyarrow.parquet as p; t = p.read_table('{file}').to_pandas(); print('LAST', {what})\""


def _last(file: str, what: str, shows: str) -> Step:
    """Show something of a table `t`."""
    return Step(_LAST.format(file=file, what=what), shows=[f"LAST {shows}"])


def _converted(one: str, other: str, factor: str) -> Case:
    """A value of 1 in one unit, as the FMU that wants the other gets it."""
    return Case(
        "fmi/units_of_the_fmu",
        [
            Step(f"python build.py '{one}' '{other}'"),
            Step("rm -rf out; servotwin run system.yaml --out out"),
            _last("out/run.parquet", "'%.6g' % t.iloc[3, 2]", factor),
        ],
    )


def _refused(one: str, other: str) -> Case:
    return Case(
        "fmi/units_of_the_fmu",
        [
            Step(f"python build.py '{one}' '{other}'"),
            Step("servotwin run system.yaml --out out", 2, [rf"{one}.*{other}|{other}.*{one}"]),
        ],
    )


CASES = {
    "fmi/units degC K": _converted("degC", "K", "274.15"),
    "fmi/units bar Pa": _converted("bar", "Pa", "100000"),
    "fmi/units km/h m/s": _converted("km/h", "m/s", "0.277778"),
    "fmi/units mNm N.m": _converted("mNm", "N.m", "0.001"),
    "fmi/units kNm N.m": _converted("kNm", "N.m", "1000"),
    "fmi/units % 1": _converted("%", "1", "0.01"),
    "fmi/units 1/min rad/s": _converted("1/min", "rad/s", "0.10472"),
    "fmi/units rpm Hz": _converted("rpm", "Hz", "0.0166667"),
    "fmi/units bar A": _refused("bar", "A"),
    "fmi/units_of_a_recording": Case(
        "fmi/units_of_a_recording",
        [
            _BUILD,
            Step("servotwin run run.yaml --out out"),
            _last("out/run.parquet", "'%.6g' % t.iloc[3, 1]", "3.14159"),
            Step("servotwin calibrate study.yaml --data data --out out2", 0, [r"c\.k.*0\.8"]),
        ],
    ),
    "fmi/info_of_a_windows_fmu": Case(
        "fmi/info_of_a_windows_fmu",
        [
            _BUILD,
            Step("servotwin info win.fmu", 0, ["win64", r"\bu\b", r"\bx\b"]),
            Step("servotwin info sources.fmu", 0, ["sources"]),
        ],
    ),
    "fmi/calibrate_fatal": Case(
        "fmi/calibrate_fatal",
        [
            _BUILD,
            Step("servotwin calibrate study.yaml --data data --out out", (0, 1), ["failed"], ["has no effect"]),
        ],
    ),
    "fmi/calibrate_hang": Case(
        "fmi/calibrate_hang",
        [
            _BUILD,
            Step(
                "servotwin calibrate study.yaml --data data --out out --isolate --patience 1",
                (0, 1, 3),
                ["failed|hang"],
            ),
        ],
    ),
    "fmi/clock_input": Case(
        "fmi/clock_input",
        [
            _BUILD,
            Step("servotwin run run.yaml --out out", (0, 3), ["tick"], ["connect it"]),
            Step("servotwin run wired.yaml --out out", 2, ["[Cc]lock"]),
            Step("servotwin run binary.yaml --out out", (0, 3), ["frames"], ["connect it"]),
        ],
    ),
    "fmi/ended_by_the_fmu": Case(
        "fmi/ended_by_the_fmu",
        [
            _BUILD,
            Step("servotwin run ended.yaml --out out"),
            _last("out/run.parquet", "len(t)", "[56]"),
            Step("servotwin run failed.yaml --stream --out out2", 3),
            _last("out2/run.parquet", "len(t)", "[56]"),
            Step("servotwin run failed.yaml --out out3", 3),
            _last("out3/run.parquet", "len(t)", "[56]"),
        ],
    ),
    "fmi/fmi3_arrays": Case(
        "fmi/fmi3_arrays",
        [
            Step("sh get.sh"),
            Step("servotwin info StateSpace.fmu", 0, [r"A\[1,1\]|A .*\[", r"\by"]),
            Step("servotwin run run.yaml --out out"),
            Step('servotwin run run.yaml --set "c.A[1,1]=2" --out out'),
        ],
    ),
    "fmi/log_flood": Case(
        "fmi/log_flood",
        [
            _BUILD,
            Step("servotwin run run.yaml --out out 2>log.txt; echo LINES $(wc -l < log.txt)", 0, [r"LINES \d{1,2}\n"]),
        ],
    ),
    "fmi/no_outputs": Case(
        "fmi/no_outputs",
        [
            _BUILD,
            Step("servotwin run run.yaml --out out", (0, 2)),
            Step("servotwin run record.yaml --out out2"),
            _last("out2/run.parquet", "list(t)", r".*c\.x"),
        ],
    ),
    "fmi/reset_refused": Case(
        "fmi/reset_refused",
        [
            _BUILD,
            Step("servotwin run refused.yaml --out out"),
            Step("cmp out/a.parquet out/b.parquet"),
            Step("servotwin run forgotten.yaml --out out2"),
            Step("cmp out2/a.parquet out2/b.parquet"),
        ],
    ),
    "fmi/terminate": Case(
        "fmi/terminate",
        [
            Step("rm -f terminated.txt; python build.py"),
            Step("servotwin run run.yaml --out out"),
            Step("servotwin run run.yaml --isolate --out out2"),
            Step("wc -l < terminated.txt", 0, [r"^2$"]),
        ],
    ),
    "fmi/too_many_steps": Case(
        "fmi/too_many_steps", [_BUILD, Step("servotwin run run.yaml --out out", 2, ["stride|stream"])]
    ),
}

"""The report's section on candidates: the table, how the choice was made, and what each one found."""

from __future__ import annotations

from identification.output_error.choice.choice import Choice
from identification.output_error.choice.ranking import LEVEL, TELLING
from identification.output_error.choice.summary import candidate_rows, summary
from orchestrator.display.table import Cell
from orchestrator.report import Section


def draw_candidates(section: Section, choice: Choice) -> None:
    """All candidates, the chosen one first."""
    found = summary(choice)
    section.paragraph(
        f"Compared by {', '.join(choice.signals)}. A candidate is out where its squared error in the "
        f"{found['windows']} windows held out is above the best one's by more than such differences scatter "
        f"({100 * LEVEL:g} % of Student's t); of the others the one of least BIC is chosen. One that predicts within "
        f"that scatter of it, and whose BIC is less than {TELLING:g} above, is not distinguishable from it. Criteria "
        f"take the noise of each output for Gaussian, with the study's weights and {found['samples']:.0f} independent "
        "samples."
    )
    section.table(*candidate_rows(found), caption="Criteria over the least one, squared errors over the chosen one's")
    names = list(dict.fromkeys(name for outcome in choice.outcomes.values() for name in outcome.values))
    rows: list[list[Cell]] = [
        [name, *(outcome.values.get(name) for outcome in choice.outcomes.values()), _unit(choice, name)]
        for name in names
    ]
    section.table(["parameter", *choice.outcomes, "unit"], rows, caption="What each candidate found")


def _unit(choice: Choice, name: str) -> str:
    return next(outcome.units.get(name, "1") for outcome in choice.outcomes.values() if name in outcome.values)

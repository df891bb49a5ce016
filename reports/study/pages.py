"""Pages of the site, from templates that escape everything."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING, Any

from eval.ratings.reading import HIGHEST, LOWEST
from reports.study.plan import Plan
from reports.study.texts import read_blocks

if TYPE_CHECKING:
    from jinja2 import Environment

#: The files that every page may load.
ASSETS: Mapping[str, str] = {
    "style.css": "text/css; charset=utf-8",
    "page.js": "text/javascript; charset=utf-8",
    "icon.svg": "image/svg+xml",
}


@cache
def _environment() -> Environment:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("reports", "templates/study"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["blocks"] = read_blocks
    return environment


@cache
def asset(name: str) -> bytes:
    """One of :data:`ASSETS`."""
    return (resources.files("reports") / "templates" / "study" / name).read_bytes()


def style_question(styles: tuple[str, str]) -> str:
    """The first question, as the 2020 study asked it for adults and children."""
    if styles == ("adult", "child"):
        return "Does this motion belong to a child or an adult?"
    return f"Is this motion {styles[0]} or {styles[1]}?"


class Pages:
    """Renders pages of one study.

    Parameters
    ----------
    plan
        The plan.
    rehearsal
        Whether every page says that answers do not count.
    """

    def __init__(self, plan: Plan, *, rehearsal: bool) -> None:
        self.plan, self.rehearsal = plan, rehearsal

    def render(self, name: str, **values: Any) -> str:
        """A page by the name of its template."""
        template = _environment().get_template(f"{name}.html.j2")
        plan = self.plan
        return template.render(
            plan=plan,
            rehearsal=self.rehearsal,
            question=style_question(plan.styles),
            minutes=f"{plan.minutes:.0f}",
            scale=range(LOWEST, HIGHEST + 1),
            **values,
        )

    def stimulus(
        self,
        name: str,
        *,
        position: int,
        first_style: int,
        wait: float,
        values: Mapping[str, str],
        problems: Mapping[str, str],
    ) -> str:
        """The page of one stimulus, with what was answered already and what is wrong with it."""
        styles = self.plan.styles if first_style == 0 else self.plan.styles[::-1]
        return self.render(
            "stimulus",
            stimulus=name,
            position=position,
            styles=styles,
            actions=self.plan.stimuli[name].actions,
            wait=round(wait, 1),
            values=values,
            problems=problems,
        )

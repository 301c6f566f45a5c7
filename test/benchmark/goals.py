"""What a benchmark answers: tables, and goals with what was reached."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

from tsmcl_ros.scripts.cli import align


@dataclass(frozen=True)
class Goal:
    """
    A figure with its bound.

    Parameters
    ----------
    what : str
        What is measured, against what.
    measured, bound : float
        In the same unit; a ratio mostly, as machines differ and are busy.
    sense : {'at most', 'at least'}
        On which side of the bound the figure should be.
    unit : str
        Of both, empty for a ratio.
    reason : str
        Why it is missed where it is: what the profile says.

    """

    what: str
    measured: float
    bound: float
    sense: Literal['at most', 'at least'] = 'at most'
    unit: str = ''
    reason: str = ''

    @property
    def is_reached(self) -> bool:
        """Whether the figure is on the right side of its bound."""
        return (self.measured <= self.bound if self.sense == 'at most'
                else self.measured >= self.bound)

    def row(self) -> tuple[str, ...]:
        """Return what a table says of it."""
        unit = f' {self.unit}' if self.unit else ''
        return (self.what, f'{self.sense} {self.bound:,g}{unit}', f'{self.measured:,.3g}{unit}',
                'reached' if self.is_reached else 'missed')


GOAL_HEADINGS = ('goal', 'wanted', 'measured', '')


@dataclass(frozen=True)
class Section:
    """
    What one benchmark found.

    Parameters
    ----------
    title : str
        Of its chapter.
    text : str
        How it was measured, and what the figures mean.
    tables : sequence of tables
        Each a sequence of rows of cells, the headings first.
    goals : sequence of Goal

    """

    title: str
    text: str
    tables: Sequence[Sequence[Sequence[str]]] = ()
    goals: Sequence[Goal] = field(default=())

    def plain(self) -> str:
        """Return it for a terminal."""
        tables = [align(table) for table in self.tables]
        if self.goals:
            tables.append(align([GOAL_HEADINGS, *(goal.row() for goal in self.goals)]))
        return '\n\n'.join([self.title, *tables, *self._reasons()])

    def markdown(self) -> str:
        """Return it as a chapter of a page."""
        tables = [as_markdown(table) for table in self.tables]
        if self.goals:
            tables.append(as_markdown([GOAL_HEADINGS, *(goal.row() for goal in self.goals)]))
        return '\n\n'.join([f'## {self.title}', self.text, *tables, *self._reasons()])

    def _reasons(self) -> list[str]:
        missed: dict[str, list[str]] = {}
        for goal in self.goals:
            if goal.reason and not goal.is_reached:
                missed.setdefault(goal.reason, []).append(goal.what)
        return [f'Missed, {"; ".join(goals)}: {reason}' for reason, goals in missed.items()]


def as_markdown(rows: Sequence[Sequence[str]]) -> str:
    """Return rows of cells as a table of Markdown, the first of them its headings."""
    head, *body = ([str(cell) for cell in row] for row in rows)
    return '\n'.join('| ' + ' | '.join(row) + ' |' for row in [head, ['---'] * len(head), *body])

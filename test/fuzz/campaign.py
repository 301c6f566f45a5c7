"""All targets, and the trying of many inputs on them."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
import importlib
import math
import multiprocessing

from harness import fuzz, HEADINGS, Outcome, Target

MODULES = ('clouds', 'poses', 'others', 'logs', 'mobility', 'parameters', 'bags', 'live')
TARGETS: dict[str, Target] = {
    target.name: target for module in MODULES
    for target in importlib.import_module(module).TARGETS}


def run(names: Sequence[str], inputs: int, seed: int) -> dict[str, Outcome]:
    """Fuzz some targets, each in a process of its own."""
    whole = sum(TARGETS[name].share for name in names)
    outcomes = {}
    for name in names:
        with ProcessPoolExecutor(1, multiprocessing.get_context('fork')) as pool:
            count = math.ceil(inputs * TARGETS[name].share / whole)
            outcomes[name] = pool.submit(_fuzz, name, count, seed).result()
    return outcomes


def table(outcomes: dict[str, Outcome]) -> list[list[str]]:
    """Return what came of it, a row a target."""
    return [HEADINGS, *(outcome.row(name) for name, outcome in outcomes.items())]


def _fuzz(name: str, inputs: int, seed: int) -> Outcome:
    return fuzz(TARGETS[name], inputs, seed)

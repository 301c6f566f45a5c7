"""What a localizer says of how its vehicles are doing, in the node and in an offline run alike."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from tsmcl_ros.localizer import Localizer
from tsmcl_ros.messages.diagnostics import Diagnosis, FAILURE, FINE, WARNING
from tsmcl_ros.model.health import LOST, OK, STALE
from tsmcl_ros.types import Array

DIAGNOSTICS_PERIOD = 1.0
"""Time [s] between two diagnoses."""

NAMES = {OK: 'OK', STALE: 'STALE', LOST: 'LOST'}
_LEVELS = {OK: FINE, STALE: WARNING, LOST: FAILURE}
_REASONS = {OK: 'OK', STALE: 'STALE: predicting through an outage',
            LOST: 'LOST: what is heard contradicts where the vehicle should be'}
_UNPLACED = {STALE: 'STALE: ranges leave the vehicle on circles around anchors so far',
             LOST: 'LOST: no beacon has told where the vehicle is'}


def diagnose(localizer: Localizer, vehicles: Sequence[str], node: str, status: Array,
             facts: Mapping[str, Any]) -> list[Diagnosis]:
    """
    Return a diagnosis of each vehicle.

    Parameters
    ----------
    localizer : Localizer
        Of V vehicles.
    vehicles : sequence of str
        Their names, V of them.
    node : str
        Name of who diagnoses.
    status : (V,) int
        OK, STALE or LOST.
    facts : mapping
        More to tell, the same of all.

    """
    health, estimate, speakers = localizer.health, localizer.estimate, localizer.speakers
    untrue = localizer.untrue
    placed = np.zeros(len(vehicles), bool)
    common = {'method': localizer.config.method, 'seed': localizer.config.seed,
              **localizer.channel.calibrated()}
    if estimate is not None:
        placed = np.isfinite(estimate.mean).all(axis=1)
        common['particles'] = estimate.particles
    diagnoses = []
    for vehicle, (name, now) in enumerate(zip(vehicles, status.tolist(), strict=True)):
        suspects = ', '.join(map(str, health.suspects[vehicle]))
        reason = _REASONS[now] if placed[vehicle] else _UNPLACED.get(now, _REASONS[now])
        values: dict[str, Any] = {
            'probability of being lost': float(health.lost[vehicle]),
            'suspects': suspects,
            'age of the last beacon [s]': float(health.age[vehicle]),
            're-initialisations': int(health.reinitializations[vehicle]),
        }
        if estimate is not None:
            values['effective particles'] = float(estimate.ess[vehicle])
            values['beacons heard'] = int(estimate.heard[vehicle])
        if not speakers.heed_all:
            values['beacons and ranges ignored'] = int(speakers.ignored[vehicle])
            values['senders ignored'] = ', '.join(map(str, sorted(speakers.senders)))
        if untrue.senders:
            values['beacons that cannot be true'] = int(untrue.ignored[vehicle])
            values['senders of what cannot be true'] = ', '.join(map(str, sorted(untrue.senders)))
        diagnoses.append(Diagnosis(
            _LEVELS[now], f'{node}: {name}',
            f'{reason}, suspects {suspects}' if suspects else reason, name,
            {key: _shown(value) for key, value in (common | values | dict(facts)).items()}))
    return diagnoses


def _shown(value: object) -> str:
    return f'{value:.6g}' if isinstance(value, float) else str(value)

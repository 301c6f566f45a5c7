"""Static networks in which nodes have ranges to each other, and rounds that localize them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from tsmcl_ros.evaluation.metrics import normalized_error_squared
from tsmcl_ros.evaluation.monte_carlo import Stopwatch
from tsmcl_ros.methods import METHODS
from tsmcl_ros.model.echo import handed_on, Hearsay
from tsmcl_ros.model.motion import motion_model, MotionConfig
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.model.radio_config import EvidenceConfig, RadioConfig
from tsmcl_ros.types import ANCHOR, Array, Estimate, Observation, PADDED, VEHICLE


@dataclass(frozen=True, eq=False)
class Network:
    """
    Anchors, then targets, that stay where they are.

    Attributes
    ----------
    anchors : (A, 2) float64
        [m].
    targets : (V, 2) float64
        [m].
    ranges : (A + V, A + V) float64
        Measured once for each pair, as by two-way ranging, which both then know [m]; NaN where
        they do not hear each other.

    """

    anchors: Array
    targets: Array
    ranges: Array

    @classmethod
    def make(cls, side: float, layout: tuple[int, int], targets: int, radio: RadioConfig,
             rng: np.random.Generator) -> Network:
        """
        Return a square network of this side [m].

        Anchors are near-uniform: one anywhere in the middle half of each cell of a layout of
        columns and rows. Targets are anywhere.
        """
        columns, rows = layout
        cells = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)
        anchors = (cells + rng.uniform(0.25, 0.75, cells.shape)) * [side / columns, side / rows]
        position = np.concatenate([anchors, rng.uniform(0, side, (targets, 2))])
        distance = np.linalg.norm(position[:, None] - position, axis=2)
        measured = np.triu(Channel(radio).hear(distance, rng).range, k=1)
        ranges = measured + measured.T
        np.fill_diagonal(ranges, np.nan)
        return cls(anchors, position[len(anchors):], ranges.astype(np.float64))

    def observe(self, belief: Estimate | None, usable: Array) -> Observation:
        """
        Return what the targets have ranges to.

        Parameters
        ----------
        belief : Estimate or None
            Of the targets that are references.
        usable : (V,) bool
            Which of them are.

        """
        anchors = len(self.anchors)
        position = np.concatenate([self.anchors, np.zeros_like(self.targets)])
        covariance = np.zeros((len(position), 2, 2))
        if belief is not None:
            position[anchors:] = np.where(usable[:, None], belief.mean, 0)
            covariance[anchors:] = np.where(usable[:, None, None], belief.covariance, 0)
        ranges = self.ranges[anchors:]
        rows = np.isfinite(ranges) & np.concatenate([np.ones(anchors, bool), usable])
        # The rows of each target first, then padding.
        sender = np.argsort(~rows, axis=1, kind='stable')[:, :max(rows.sum(axis=1).max(), 1)]
        used = np.take_along_axis(rows, sender, axis=1)
        observation = Observation.empty(len(ranges), sender.shape[1], 2, 0.0)
        observation.sender[:] = np.where(used, sender, PADDED)
        observation.kind[:] = np.where(sender < anchors, ANCHOR, VEHICLE)
        observation.position[:] = position[sender]
        observation.covariance[:] = covariance[sender]
        observation.range[:] = np.where(used, np.take_along_axis(ranges, sender, axis=1), np.nan)
        return observation


class Rounds(NamedTuple):
    """Rounds T of V targets: error [m], NEES, whether localized (T, V); processor time [s]."""

    error: Array
    nees: Array
    localized: Array
    seconds: float


def cooperate(network: Network, method: str, settings: dict[str, Any], radio: RadioConfig,
              rounds: int, reference_std: float, seed: np.random.SeedSequence) -> Rounds:
    """
    Localize all targets from their references, round by round.

    Every round starts from the same ranges to anchors and to the targets that the round before
    has localized, and not from beliefs, in which these ranges count already. Beside its covariance
    a target tells what of it is by the errors of its references, which others share. A target is
    localized if its search among directions has settled and its estimate's standard deviation is
    at most `reference_std` [m].
    """
    vehicles = len(network.targets)
    channel = Channel(radio, EvidenceConfig(
        use_heard=False, silence='none', range_calibration='off', outlier_fraction=0.0))
    motion = motion_model(MotionConfig(motion_model='random'), 2, odometry=False)
    kind = METHODS[method]
    usable, estimate = np.zeros(vehicles, bool), None
    shared = np.zeros((vehicles, 2, 2))
    found: list[tuple[Array, Array, Array]] = []
    watch = Stopwatch()
    for child in seed.spawn(rounds):
        filter_ = kind(kind.Config(**settings), channel, motion, vehicles, 2,
                       np.random.default_rng(child))
        observation = network.observe(estimate, usable)
        claimed = observation if estimate is None else network.observe(
            replace(estimate, covariance=shared), usable)
        with watch:
            alone = filter_.update(observation)
            std, ranged = channel.resolution(observation)
            hearsay = Hearsay(vehicles, 2)
            estimate = hearsay.add(alone, claimed, observation, std, ranged)
            shared = hearsay.covariance + handed_on(alone, observation, std, ranged)
        settled = getattr(filter_, 'settled', np.ones(vehicles, bool))
        # Who has heard nobody yet has no estimate, and compares as false.
        spread = np.sqrt(np.trace(estimate.covariance, axis1=1, axis2=2))
        usable = settled & (spread <= reference_std)
        off = estimate.mean - network.targets
        known = np.isfinite(off).all(axis=1)
        nees = np.full(vehicles, np.nan)
        nees[known] = normalized_error_squared(off[known], estimate.covariance[known])
        found.append((np.linalg.norm(off, axis=1), nees, usable))
    error, squared, localized = (np.stack(values) for values in zip(*found, strict=True))
    return Rounds(error, squared, localized, watch.seconds)

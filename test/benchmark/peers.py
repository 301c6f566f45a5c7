"""
One vehicle with 500 particles: the bootstrap filter beside those of other Python packages.

    python test/benchmark/run.py peers

All filters get the same odometry and the rssi of the same six anchors, start from the same prior,
reckon with the same models of both, and resample when the effective sample size is below half.
What they score by is the same numpy code. Each is used as its documentation has it:
https://particles-sequential-monte-carlo-in-python.readthedocs.io, https://stonesoup.readthedocs.io,
https://filterpy.readthedocs.io with the book that it refers to, https://github.com/johnhw/pfilter.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import datetime
from statistics import median
import time
from typing import Any

from goals import Goal, Section
import numpy as np
from tsmcl_ros.config import build
from tsmcl_ros.localizer import Localizer
from tsmcl_ros.methods.ts_mcl import TsMcl, TsMclConfig
from tsmcl_ros.model.motion import MotionConfig, OdometryMotion
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.model.radio_config import EvidenceConfig, RadioConfig
from tsmcl_ros.types import Array, Motion, Prior
from tsmcl_ros.world import Epoch, make_world

PARTICLES, EPOCHS, SEEDS = 500, 100, 15
PRIOR_STD, STEP_STD = 20.0, 10.0  # m
EXPONENT, SIGMA = 3.0, 3.0  # of path loss; dB
RADIO: dict[str, Any] = {
    'radio_model': 'lognormal', 'path_loss_exponent': EXPONENT, 'sigma_db': SIGMA,
    'rssi_at_reference': 0.0, 'sensitivity': -300.0, 'measure_rssi': True}
WORLD = {
    **RADIO, 'vehicles': 1, 'anchor_rows': 2, 'anchor_columns': 3, 'anchor_spacing': 200.0,
    'anchor_jitter': 40.0, 'area_x': 600.0, 'area_y': 400.0, 'max_speed': 10.0,
    'odom_noise': STEP_STD}
# The same models as the peers': every rssi is Gaussian, and nothing else is known.
OURS = {
    **RADIO, 'motion_model': 'odometry', 'odom_heading': 'known', 'odom_std': STEP_STD,
    'alpha3': 0.0, 'alpha4': 0.0, 'outlier_fraction': 0.0, 'silence': 'none',
    'min_particles': PARTICLES, 'max_particles': PARTICLES, 'max_iterations': 0, 'jitter': 0.0}
THRESHOLD = 0.5
REASON = (
    'one vehicle is too few for the batch axis to help. By cProfile an update makes 370 calls, '
    'each of which costs about the same whatever its size: 21 % make the estimate, 19 % lay the '
    'evidence out, 19 % resample, 15 % score, 13 % predict. Written by hand for this case alone '
    'numpy itself comes to nearly 0.4, which leaves nothing for what a filter of any evidence, '
    'uncertain references and recovery asks of an epoch.')


@dataclass(frozen=True, eq=False)
class Drive:
    """
    What a vehicle's filters are told in T epochs, and the truth.

    Attributes
    ----------
    epochs : list of T Epoch
    truth, way : (T, 2) float
        Positions, and displacements by odometry [m].
    anchors : (6, 2) float
        [m].
    rssi : (T, 6) float
        [dBm].
    start : (2,) float
        Mean of the prior [m].

    """

    epochs: list[Epoch]
    truth: Array
    way: Array
    anchors: Array
    rssi: Array
    start: Array

    @classmethod
    def simulate(cls, seed: int) -> Drive:
        """Return one through a world of its own."""
        rng = np.random.default_rng(seed)
        world = make_world(WORLD, rng)
        begin = world.mobility.state.position[0]
        epochs = [world.step() for _ in range(EPOCHS)]
        odometry = np.concatenate([epoch.odom_position for epoch in epochs])
        heard = [epoch.observation for epoch in epochs]
        assert all((each.sender == heard[0].sender).all() for each in heard)
        return cls(
            epochs, np.concatenate([epoch.position for epoch in epochs]),
            np.diff(odometry, axis=0, prepend=0), heard[0].position[0].astype(float),
            np.concatenate([each.rssi for each in heard]).astype(float),
            begin + PRIOR_STD * rng.standard_normal(2))

    def expected(self, points: Array) -> Array:
        """Return the mean rssi (6, N) [dBm] at points (N, 2)."""
        away = points.T[:, None, :] - self.anchors.T[:, :, None]
        np.square(away, out=away)
        return -5 * EXPONENT * np.log10(away[0] + away[1])

    def log_likelihood(self, epoch: int, points: Array) -> Array:
        """Return that (N,) of an epoch's rssi at points (N, 2)."""
        off = self.rssi[epoch][:, None] - self.expected(points)
        return -0.5 / SIGMA ** 2 * np.einsum('kn,kn->n', off, off)

    def prior(self, count: int) -> Array:
        """Return points (count, 2) of the prior."""
        return self.start + PRIOR_STD * np.random.standard_normal((count, 2))


# Takes in an epoch, by number, and returns the mean (2,) [m].
Filter = Callable[[int], Array]


def method(drive: Drive, seed: int) -> Filter:
    """Return our method on its own: what a localizer asks of it."""
    channel = Channel(build(RadioConfig, RADIO), build(EvidenceConfig, {
        'outlier_fraction': 0.0, 'silence': 'none'}))
    motion = OdometryMotion(build(MotionConfig, OURS))
    ours = TsMcl(build(TsMclConfig, OURS), channel, motion, 1, 2,
                 np.random.Generator(np.random.SFC64(seed)))
    ours.start(Prior(0, drive.start, PRIOR_STD ** 2 * np.eye(2)))

    def step(epoch: int) -> Array:
        ours.predict(Motion(1.0, drive.way[epoch][None], np.zeros(1)))
        return np.asarray(ours.update(drive.epochs[epoch].observation).mean[0])

    return step


def localizer(drive: Drive, seed: int) -> Filter:
    """Return all that the localizer does with an epoch: odometry, health, outages and so on."""
    x, y = (drive.start + drive.way[0]).tolist()
    ours = Localizer({**OURS, 'seed': seed, 'set_initial_pose': True,
                      'initial_pose.x': x, 'initial_pose.y': y,
                      'initial_pose.std': float(np.hypot(PRIOR_STD, STEP_STD))})

    def step(epoch: int) -> Array:
        now = drive.epochs[epoch]
        return np.asarray(ours.epoch(now.observation, now.odom_position, now.odom_yaw).mean[0])

    return step


def by_hand(drive: Drive, seed: int) -> Filter:
    """Return the same filter in as few float32 operations as numpy needs: for this case alone."""
    rng = np.random.Generator(np.random.SFC64(seed))
    x, y = drive.prior(PARTICLES).astype(np.float32).T
    east, north = drive.anchors.T.astype(np.float32)[:, :, None]
    rssi, way = drive.rssi.astype(np.float32)[:, :, None], drive.way.astype(np.float32)
    log_weights = np.float32(0)
    slope, sharpness = np.float32(5 * EXPONENT), np.float32(-0.5 / SIGMA ** 2)
    number, std = np.arange(PARTICLES), np.float32(STEP_STD)

    def step(epoch: int) -> Array:
        nonlocal x, y, log_weights
        noise = rng.standard_normal((2, PARTICLES), np.float32)
        noise *= std
        x, y = x + way[epoch, 0] + noise[0], y + way[epoch, 1] + noise[1]
        off, squared = y - north, x - east
        off *= off
        squared *= squared
        squared += off
        np.log10(squared, out=squared)
        squared *= slope
        squared += rssi[epoch]
        squared *= squared
        log_weights = log_weights + sharpness * squared.sum(axis=0)
        weights = np.exp(log_weights - log_weights.max())
        weights /= weights.sum()
        mean = np.array([weights @ x, weights @ y])
        if 1 / (weights @ weights) < THRESHOLD * PARTICLES:
            edges = np.ceil(weights.cumsum() * PARTICLES - rng.random()).astype(int)
            edges[-1] = PARTICLES
            edges[1:] -= edges[:-1]
            index = number.repeat(np.maximum(edges, 0))
            x, y, log_weights = x[index], y[index], np.float32(0)
        return mean

    return step


def particles(drive: Drive, seed: int) -> Filter:
    """Return `particles.SMC` of a Feynman-Kac model, the package's own core."""
    from particles import FeynmanKac, SMC

    class Model(FeynmanKac):
        def M0(self, N: int) -> Array:  # noqa: N802, N803
            return self.M(0, drive.prior(N))

        def M(self, t: int, xp: Array) -> Array:  # noqa: N802
            return xp + drive.way[t] + STEP_STD * np.random.standard_normal(xp.shape)

        def logG(self, t: int, xp: Array, x: Array) -> Array:  # noqa: N802
            return drive.log_likelihood(t, x)

    smc = SMC(fk=Model(EPOCHS), N=PARTICLES, ESSrmin=THRESHOLD, collect='off')

    def step(_: int) -> Array:
        next(smc)
        return np.asarray(smc.W @ smc.X)

    return step


def state_space(drive: Drive, seed: int) -> Filter:
    """Return `particles.SMC` of the bootstrap filter of a state-space model."""
    from particles import distributions, SMC, state_space_models

    noise = STEP_STD ** 2 * np.eye(2)

    class Model(state_space_models.StateSpaceModel):
        def PX0(self) -> Any:  # noqa: N802
            return distributions.MvNormal(
                drive.start + drive.way[0], cov=PRIOR_STD ** 2 * np.eye(2) + noise)

        def PX(self, t: int, xp: Array) -> Any:  # noqa: N802
            return distributions.MvNormal(xp + drive.way[t], cov=noise)

        def PY(self, t: int, xp: Array, x: Array) -> Any:  # noqa: N802
            return distributions.MvNormal(drive.expected(x).T, cov=SIGMA ** 2 * np.eye(6))

    smc = SMC(fk=state_space_models.Bootstrap(ssm=Model(), data=drive.rssi), N=PARTICLES,
              ESSrmin=THRESHOLD, collect='off')

    def step(_: int) -> Array:
        next(smc)
        return np.asarray(smc.W @ smc.X)

    return step


def filterpy(drive: Drive, seed: int) -> Filter:
    """Return the loop of `filterpy`'s book, with its resampling."""
    from filterpy.monte_carlo import systematic_resample

    points, weights = drive.prior(PARTICLES), np.full(PARTICLES, 1 / PARTICLES)

    def step(epoch: int) -> Array:
        nonlocal points, weights
        points = points + drive.way[epoch] + STEP_STD * np.random.standard_normal(points.shape)
        weights = weights * np.exp(drive.log_likelihood(epoch, points))
        weights += 1e-300
        weights /= weights.sum()
        mean = np.average(points, weights=weights, axis=0)
        if 1 / np.square(weights).sum() < THRESHOLD * PARTICLES:
            points = points[systematic_resample(weights)]
            weights = np.full(PARTICLES, 1 / PARTICLES)
        return np.asarray(mean)

    return step


def pfilter(drive: Drive, seed: int) -> Filter:
    """Return `pfilter.ParticleFilter`."""
    from pfilter import gaussian_noise, ParticleFilter, systematic_resample

    ours = ParticleFilter(
        prior_fn=drive.prior, n_particles=PARTICLES, resample_fn=systematic_resample,
        n_eff_threshold=THRESHOLD, observe_fn=lambda points, **_: drive.expected(points).T,
        dynamics_fn=lambda points, way: points + way,
        noise_fn=lambda points, **_: gaussian_noise(points, [STEP_STD, STEP_STD]),
        weight_fn=lambda expected, rssi, **_: np.exp(
            -0.5 / SIGMA ** 2 * np.square(expected - rssi).sum(axis=1)))

    def step(epoch: int) -> Array:
        ours.update(drive.rssi[epoch], way=drive.way[epoch])
        return np.asarray(ours.mean_state)

    return step


def stonesoup(drive: Drive, seed: int) -> Filter:
    """Return `stonesoup`'s predictor, updater and resampler."""
    from stonesoup.models.control.linear import LinearControlModel
    from stonesoup.models.measurement.nonlinear import NonLinearGaussianMeasurement
    from stonesoup.models.transition.linear import (
        CombinedLinearGaussianTransitionModel,
        RandomWalk,
    )
    from stonesoup.predictor.particle import ParticlePredictor
    from stonesoup.resampler.particle import ESSResampler
    from stonesoup.types.array import StateVector, StateVectors
    from stonesoup.types.detection import Detection
    from stonesoup.types.hypothesis import SingleHypothesis
    from stonesoup.types.state import ParticleState, State
    from stonesoup.updater.particle import ParticleUpdater

    class Rssi(NonLinearGaussianMeasurement):
        ndim_meas = 6

        def function(self, state: Any, noise: bool = False, **_: Any) -> Any:
            return StateVectors(drive.expected(np.asarray(state.state_vector, float).T))

    walk = CombinedLinearGaussianTransitionModel([RandomWalk(STEP_STD ** 2)] * 2)
    predictor = ParticlePredictor(walk, control_model=LinearControlModel(np.eye(2)))
    updater = ParticleUpdater(
        Rssi(ndim_state=2, mapping=(0, 1), noise_covar=SIGMA ** 2 * np.eye(6)),
        resampler=ESSResampler())
    begin = datetime.datetime(2026, 1, 1)
    belief = ParticleState(
        StateVectors(drive.prior(PARTICLES).T), timestamp=begin,
        weight=np.full(PARTICLES, 1 / PARTICLES))

    def step(epoch: int) -> Array:
        nonlocal belief
        stamp = begin + datetime.timedelta(seconds=epoch + 1)
        prediction = predictor.predict(
            belief, timestamp=stamp, control_input=State(StateVector(drive.way[epoch])))
        belief = updater.update(SingleHypothesis(
            prediction, Detection(StateVector(drive.rssi[epoch]), timestamp=stamp)))
        return np.asarray(belief.mean, float).ravel()

    return step


METHOD, LOCALIZER = 'ours, the method', 'ours, Localizer.epoch'
BY_HAND, BEST = 'numpy by hand, this case alone', 'particles'
FILTERS: dict[str, Callable[[Drive, int], Filter]] = {
    METHOD: method, LOCALIZER: localizer, BY_HAND: by_hand, BEST: particles,
    'particles, state-space model': state_space, 'filterpy': filterpy, 'pfilter': pfilter,
    'stonesoup': stonesoup}


def measure() -> Section:
    """Run all filters on the same drives, one after the other on each."""
    times: dict[str, list[float]] = {name: [] for name in FILTERS}
    errors: dict[str, list[Array]] = {name: [] for name in FILTERS}
    for seed in range(SEEDS):
        drive = Drive.simulate(seed)
        np.random.seed(seed)
        for name, make in FILTERS.items():
            try:
                step = make(drive, seed)
            except ImportError:
                continue
            mean, taken = _run(step)
            times[name].append(taken)
            errors[name].append(mean - drive.truth)
    return Section(
        'Peers',
        f'One vehicle, {PARTICLES} particles, odometry and the rssi of six anchors: an update is '
        'prediction, weighing, the mean, and resampling where it is due, by processor time; '
        f'medians over {SEEDS} drives of {EPOCHS} epochs, which all filters see, one after the '
        'other. All score by the same models. `Localizer.epoch` adds what no peer does: '
        "odometry's buffer, health, outages, the echo guard.",
        [_table(times, errors)], _goals(times, errors))


def _run(step: Filter) -> tuple[Array, float]:
    """Return the means (T, 2) [m], and the processor time of an epoch on average [s]."""
    means = [step(0)]
    begin = time.process_time()
    means += [step(epoch) for epoch in range(1, EPOCHS)]
    return np.stack(means), (time.process_time() - begin) / (EPOCHS - 1)


def _table(times: dict[str, list[float]], errors: dict[str, list[Array]]) -> list[list[str]]:
    rows = [['filter', 'an update', 'and of it a particle', f'over {BEST}', 'RMSE']]
    for name, taken in times.items():
        if not taken:
            rows.append([name, 'not installed', '', '', ''])
            continue
        each = median(taken)
        over = f'{_ratio(taken, times[BEST]):.2f}' if times[BEST] else ''
        rows.append([name, f'{1e6 * each:.0f} us', f'{1e9 * each / PARTICLES:.0f} ns', over,
                     f'{_rmse(errors[name]):.2f} m'])
    return rows


def _goals(times: dict[str, list[float]], errors: dict[str, list[Array]]) -> list[Goal]:
    if not times[BEST]:
        return []
    return [
        Goal(f'our method over {BEST}, time of an update',
             _ratio(times[METHOD], times[BEST]), 0.4, reason=REASON),
        Goal(f'our method over {BEST}, RMSE', _rmse(errors[METHOD]) / _rmse(errors[BEST]), 1.02)]


def _ratio(times: list[float], others: list[float]) -> float:
    """Return the median ratio of times on the same drive."""
    return median(one / other for one, other in zip(times, others, strict=True))


def _rmse(errors: list[Array]) -> float:
    """Return the root mean square of what (T, 2) errors [m] of several drives are long."""
    return float(np.sqrt(np.mean(np.square(errors).sum(axis=2))))

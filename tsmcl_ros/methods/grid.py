"""
Exact Bayes filter on a grid: the yardstick that tells how far from the optimum the others are.

A two-dimensional histogram filter with the same channel, evidence and motion as the particle
filters. Its time and memory grow with the area, so it is not for deployment.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from tsmcl_ros.config import Config, param
from tsmcl_ros.model.motion import MotionModel, OdometryMotion, RandomMotion
from tsmcl_ros.model.particles import moments, normalize
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.types import Array, ConfigError, Estimate, Motion, Observation, Prior


@dataclass(frozen=True)
class GridConfig(Config):
    """The grid: its cells, and the area if the first observation is not to give it."""

    grid_cell: float = param(10.0, 'edge of a cell', unit='m', above=0.0)
    grid_margin: float = param(
        0.0, 'grow the area beyond where the references seen first leave the vehicles',
        unit='m', low=0.0)
    grid_max_cells: int = param(
        1_000_000, 'refuse areas of more cells than this', low=1, high=100_000_000)
    grid_x_min: float = param(0.0, 'area; all four 0 for what the first observation gives',
                              unit='m')
    grid_x_max: float = param(0.0, 'see grid_x_min', unit='m')
    grid_y_min: float = param(0.0, 'see grid_x_min', unit='m')
    grid_y_max: float = param(0.0, 'see grid_x_min', unit='m')

    def check(self) -> None:
        """Hold that the area is one."""
        corners = (self.grid_x_min, self.grid_x_max, self.grid_y_min, self.grid_y_max)
        if any(corners) and (self.grid_x_min >= self.grid_x_max
                             or self.grid_y_min >= self.grid_y_max):
            raise ConfigError(
                f'grid_x_min, grid_x_max, grid_y_min, grid_y_max: {corners} is not allowed, '
                'must be all 0 or each minimum below its maximum')


class Grid:
    """
    Histogram filter of V vehicles over one area: convolve with the motion, multiply, normalize.

    Raises
    ------
    ConfigError
        If the motion model or the dimension is not one that a grid can hold, or the area has
        too many cells.

    """

    Config = GridConfig

    def __init__(self, config: GridConfig, channel: Channel, motion: MotionModel,
                 vehicles: int, dimension: int, rng: np.random.Generator):
        if dimension != 2:
            raise ConfigError(f'dimension: {dimension} is not allowed for method grid, must be 2')
        if not isinstance(motion, (RandomMotion, OdometryMotion)) or motion.heading:
            raise ConfigError(
                'method: grid holds positions only, so motion_model must be random, or odometry '
                'with odom_heading known')
        self.config = config
        self.channel = channel
        self.motion = motion
        self.vehicles = vehicles
        self.placed = np.zeros(vehicles, bool)
        self.belief = np.zeros((vehicles, 0, 0))
        self.cells = np.zeros((0, 2), np.float32)
        self._log_likelihood = np.full(vehicles, np.nan)
        self._pending: list[Prior] = []

    @property
    def particles(self) -> Array:
        """(V, 0, 2): a grid has none."""
        return np.zeros((self.vehicles, 0, 2), np.float32)

    def start(self, prior: Prior) -> None:
        """Replace one vehicle's belief by a prior, once there is an area."""
        self._pending.append(prior)

    def forget(self, vehicle: int) -> None:
        """Drop one vehicle's belief: it starts uniform at its next beacon."""
        self.placed[vehicle] = False

    def predict(self, motion: Motion) -> None:
        """Convolve each belief with its motion kernel."""
        if self.belief.size:
            moved = scipy.signal.oaconvolve(
                self.belief, self._kernels(motion), mode='same', axes=(1, 2))
            self.belief = _normalized(np.maximum(moved, 0))

    def update(self, observation: Observation) -> Estimate:
        """Multiply each belief by the likelihood of what was heard."""
        evidence = self.channel.evidence(observation)
        if not self.belief.size and evidence.heard.any():
            self._lay_out(evidence.box[evidence.heard])
        self._start_pending()
        excluded = np.zeros(self.vehicles, bool)
        if self.belief.size:
            new = evidence.heard & ~self.placed
            self.belief[new] = 1 / len(self.cells)
            self.placed |= new
            likelihood = evidence.log_likelihood(self.cells[None]).astype(np.float64)
            with np.errstate(divide='ignore'):
                posterior = np.log(self.belief.reshape(self.vehicles, -1)) + likelihood
            _, total = normalize(posterior)
            excluded = self.placed & (total < np.log(1e-300))
            posterior[excluded] = likelihood[excluded]
            peak = posterior.max(axis=1, keepdims=True)
            self.belief = _normalized(np.exp(posterior - peak).reshape(self.belief.shape))
            self._log_likelihood = total
        return self._estimate(observation, excluded)

    def moments(self) -> tuple[Array, Array]:
        """Return mean (V, 2) [m] and covariance (V, 2, 2) [m^2], NaN where unplaced."""
        mean = np.full((self.vehicles, 2), np.nan)
        covariance = np.full((self.vehicles, 2, 2), np.nan)
        if self.belief.size:
            mean, covariance = moments(
                np.broadcast_to(self.cells, (self.vehicles, *self.cells.shape)),
                self.belief.reshape(self.vehicles, -1))
            # A cell's own width is uncertain, too.
            covariance += np.eye(2) * self.config.grid_cell ** 2 / 12
            mean[~self.placed] = covariance[~self.placed] = np.nan
        return mean, covariance

    def _estimate(self, observation: Observation, excluded: Array) -> Estimate:
        """Return the moments of every belief, and how it is doing."""
        heard = observation.heard.sum(axis=1)
        unknown = np.full(self.vehicles, np.nan)
        mean, covariance = self.moments()
        ess = np.zeros(self.vehicles)
        if self.belief.size:
            ess = 1 / np.square(self.belief).sum(axis=(1, 2))
        return Estimate(
            stamp=observation.stamp, mean=mean, covariance=covariance,
            rotation=unknown, rotation_variance=unknown, ess=ess, particles=len(self.cells),
            log_likelihood=np.where(heard > 0, self._log_likelihood, np.nan), heard=heard,
            reinitialized=excluded)

    def _lay_out(self, boxes: Array) -> None:
        """Lay the cells over the area: the configured one, or the boxes (B, 2, 2) [m] hull."""
        config = self.config
        low = boxes[:, 0].min(axis=0).astype(np.float64) - config.grid_margin
        high = boxes[:, 1].max(axis=0).astype(np.float64) + config.grid_margin
        if config.grid_x_max > config.grid_x_min:
            low = np.array([config.grid_x_min, config.grid_y_min])
            high = np.array([config.grid_x_max, config.grid_y_max])
        count = np.maximum(np.ceil((high - low) / config.grid_cell), 1).astype(int)
        if count.prod() > config.grid_max_cells:
            raise ConfigError(
                f'grid_cell: {config.grid_cell:g} m cuts the area of {high[0] - low[0]:.0f} x '
                f'{high[1] - low[1]:.0f} m into {count.prod()} cells, grid_max_cells allows '
                f'{config.grid_max_cells}')
        axes = [start + config.grid_cell * (np.arange(size) + 0.5)
                for start, size in zip(low, count, strict=True)]
        mesh = np.stack(np.meshgrid(*axes, indexing='ij'), axis=-1)
        self.cells = mesh.reshape(-1, 2).astype(np.float32)
        self.belief = np.full((self.vehicles, *count), 1 / len(self.cells))

    def _start_pending(self) -> None:
        """Turn priors into beliefs, once there is an area."""
        if self.belief.size:
            for prior in self._pending:
                delta = self.cells - prior.mean
                # A cell's own width counts, or an exact prior would fall between the cells.
                precision = np.linalg.inv(
                    prior.covariance + np.eye(2) * self.config.grid_cell ** 2 / 12)
                log = -0.5 * np.einsum('ci,ij,cj->c', delta, precision, delta)
                self.belief[prior.vehicle] = normalize(log[None])[0].reshape(
                    self.belief.shape[1:])
                self.placed[prior.vehicle] = True
            self._pending = []

    def _kernels(self, motion: Motion) -> Array:
        """Return each vehicle's motion kernel (V, 2 n + 1, 2 n + 1)."""
        cell = self.config.grid_cell
        if isinstance(self.motion, RandomMotion):
            kernel = disk_kernel(self.motion.reach(motion.elapsed) / cell)
            return np.asarray(np.broadcast_to(kernel, (self.vehicles, *kernel.shape)))
        displacement, _, noise = self.motion.measured(motion, self.vehicles, 2)
        shift, std = displacement / cell, noise[:, None] / cell
        reach = int(np.ceil(np.abs(shift).max() + 5 * std.max() + 1))
        offsets = np.arange(-reach, reach + 1)[None]
        x, y = (hat_kernel(offsets - shift[:, axis, None], std) for axis in (0, 1))
        return np.asarray(x[:, :, None] * y[:, None, :])


def disk_kernel(radius: float) -> Array:
    """
    Return a uniform disk of this radius [cells] as a square with an odd number of cells.

    An even number would drift by half a cell a step. The disk is convolved with a linear
    interpolation hat, so that one smaller than a cell spreads the belief as well.
    """
    reach = int(np.ceil(radius)) + 1
    cells = np.arange(-reach, reach + 1)
    size = 8 * reach + 64
    raster = (2 * np.arange(size) + 1) / size - 1
    inside = raster[:, None] ** 2 + raster[None, :] ** 2 <= 1
    hat = np.maximum(1 - np.abs(cells[:, None] - radius * raster), 0)
    kernel = hat @ inside @ hat.T
    return np.asarray(kernel / kernel.sum())


def hat_kernel(offset: Array, std: Array) -> Array:
    """
    Return the weights of cells at these offsets from a Gaussian's mean, all in cells.

    The Gaussian is convolved with a linear interpolation hat, so the weights sum to 1 and keep
    the mean exactly however narrow it is.
    """
    std = np.maximum(std, 1e-6)

    def ramp(x: Array) -> Array:
        density = np.exp(-0.5 * (x / std) ** 2) / np.sqrt(2 * np.pi)
        return np.asarray(x * scipy.special.ndtr(x / std) + std * density)

    return np.asarray(ramp(offset + 1) - 2 * ramp(offset) + ramp(offset - 1))


def _normalized(belief: Array) -> Array:
    """Scale each belief (V, X, Y) to sum 1; one without any mass becomes uniform."""
    total = belief.sum(axis=(1, 2), keepdims=True)
    cells = belief.shape[1] * belief.shape[2]
    return np.asarray(np.where(total > 0, belief / np.where(total > 0, total, 1), 1 / cells))

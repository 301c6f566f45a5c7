"""
NBP: nonparametric belief propagation, the baseline of cooperative localization.

Ihler, Fisher, Moses, Willsky: Nonparametric belief propagation for self-localization of sensor
networks, IEEE Journal on Selected Areas in Communications 23 (2005). Every reference sends a
message, a mixture of M Gaussian kernels: samples of its belief pushed along the measured range in
uniform directions. The belief is the messages' product, by mixture importance sampling: samples
of all messages together, weighed by the product over the sum of them. One resolution: the usual
rule of thumb for the width of kernels takes the whole ring for one hump and smears it to a disk;
here it is the same rule for a ring.
"""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import ClassVar

import numpy as np
from tsmcl_ros.config import param
from tsmcl_ros.model.cooperation import CooperationConfig, CooperativeFilter, Proposal
from tsmcl_ros.model.evidence import Evidence
from tsmcl_ros.model.geometry import Arcs
from tsmcl_ros.model.motion import MotionModel
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.model.ranging import Ranging, without_ranges
from tsmcl_ros.model.rings import Rings
from tsmcl_ros.types import Array, Observation


@dataclass(frozen=True)
class NbpConfig(CooperationConfig):
    """The product of messages."""

    oversampling: int = param(
        5, 'samples of the product that are weighed for each one that a message has, k',
        low=1, high=1000, live=True)
    kernel_scale: float = param(
        1.0, "width of a message's kernels, in what is best for a ring", above=0.0, live=True)


class Nbp(CooperativeFilter):
    """Nonparametric belief propagation of V vehicles."""

    Config = NbpConfig

    def __init__(self, config: NbpConfig, channel: Channel, motion: MotionModel,
                 vehicles: int, dimension: int, rng: np.random.Generator):
        super().__init__(config, channel, motion, vehicles, dimension, rng)
        self.config: NbpConfig = config

    def cost(self, references: int) -> int:
        """Return how many kernels one message of a vehicle is worked on with at a time."""
        samples = self.config.reference_samples
        return max(references, samples) * (
            self.config.oversampling * samples + self.config.min_particles)

    def propose(self, observation: Observation) -> Proposal:
        """Draw candidates from all messages."""
        config = self.config
        ranging, rest = without_ranges(self.channel.evidence(observation))
        assert ranging is not None
        rings = Rings(ranging, Arcs.circles(observation.sender.shape))
        samples, _ = rings.draw(config.reference_samples, self.rng)
        messages = Messages.of(ranging, samples, config.kernel_scale)
        points = messages.draw(config.oversampling * config.reference_samples, self.rng)
        return Product(points, np.ones(points.shape[:2], bool), np.zeros((len(points), 2)),
                       messages.grain, messages, rest)


@dataclass(frozen=True, eq=False)
class Messages:
    """
    Mixtures of M Gaussian kernels that K references send V vehicles.

    Attributes
    ----------
    ranging : Ranging
        What they are made from.
    centres : (V, K, M, 2) float32
        [m].
    weights : (V, K, M) float32
        Each message's sum to 1.
    width : (V, K) float32
        Standard deviation of the kernels [m].
    girth : (V, K) float32
        Mean length of the ring [m]: density on the plane against density of distance.

    """

    ranging: Ranging
    centres: Array
    weights: Array
    width: Array
    girth: Array

    @classmethod
    def of(cls, ranging: Ranging, samples: Array, scale: float) -> Messages:
        """
        Return messages of samples (V, K, M, 2) [m], uniform in direction from the references.

        A ring's length grows with its radius, so samples further out weigh more.
        """
        vehicles, references, count, _ = samples.shape
        distance = np.stack([
            ranging.references.distance(samples[:, index])[0][:, index]
            for index in range(references)], axis=1)
        distance = np.maximum(distance, np.float32(1e-3))
        radius, spread = distance.mean(axis=2), np.maximum(distance.std(axis=2), 1e-3)
        # Least mean integrated squared error, as Silverman (1986, section 4.3) derives it, of a
        # density that is Gaussian across a ring of this radius and uniform along it.
        best = (8 * math.sqrt(math.pi) / 3 * radius * spread ** 5 / count) ** (1 / 6)
        # Not so narrow that float32 could not tell squared distances on the ring.
        best = np.maximum(best, 1e-3 * radius / scale)
        return cls(ranging, samples, distance / distance.sum(axis=2, keepdims=True),
                   (scale * best).astype(np.float32), 2 * np.float32(np.pi) * radius)

    @property
    def grain(self) -> Array:
        """(V,) float32: standard deviation [m] of the product of a kernel of each message."""
        precision = np.where(self.ranging.used[:, :, 0], 1 / np.square(self.width), 0)
        return 1 / np.sqrt(precision.sum(axis=1))

    def draw(self, count: int, rng: np.random.Generator) -> Array:
        """Return points (V, count, 2) [m] of all messages in equal parts."""
        used = self.ranging.used[:, :, 0]
        order = np.argsort(~used, axis=1, kind='stable')
        turn = np.arange(count) % np.maximum(used.sum(axis=1), 1)[:, None]
        message = np.take_along_axis(order, turn, axis=1)
        vehicle = np.arange(len(used))[:, None]
        edges = np.cumsum(self.weights, axis=2)[vehicle, message]
        uniform = rng.random((*message.shape, 1), np.float32) * edges[:, :, -1:]
        kernel = np.minimum((edges <= uniform).sum(axis=2), edges.shape[2] - 1)
        noise = rng.standard_normal((*message.shape, 2), np.float32)
        return np.asarray(self.centres[vehicle, message, kernel]
                          + self.width[vehicle, message][:, :, None] * noise)

    def density(self, points: Array) -> Array:
        """Return the messages (V, K, P) [1/m^2] at points (V, P, 2) [m]."""
        found = []
        for index in range(self.centres.shape[1]):
            width = self.width[:, index, None, None]
            # About the reference, where float32 has digits for squares to cancel.
            origin = np.moveaxis(self.ranging.references.position[:, :, index], 0, -1)
            at, centre = (points - origin) / width, (self.centres[:, index] - origin) / width
            # Minus half the squared distances, as one product of matrices.
            at = np.concatenate(
                [at, -np.square(at).sum(axis=2, keepdims=True) / 2, np.ones_like(at[..., :1])], 2)
            centre = np.concatenate(
                [centre, np.ones_like(centre[..., :1]),
                 -np.square(centre).sum(axis=2, keepdims=True) / 2], 2)
            kernels = at @ np.swapaxes(centre, 1, 2)
            np.exp(kernels, out=kernels)
            found.append((kernels @ self.weights[:, index, :, None])[:, :, 0]
                         / (2 * np.float32(np.pi) * width[:, 0] ** 2))
        return np.stack(found, axis=1)


@dataclass(frozen=True, eq=False)
class Product(Proposal):
    """Candidates of a product of messages."""

    exact: ClassVar[bool] = False

    messages: Messages
    rest: Evidence

    def score(self, points: Array) -> tuple[Array, Array]:
        """Return log-likelihoods (W, P) of points (W, P, 2), and ln of the density drawn from."""
        messages, ranging = self.messages, self.messages.ranging
        density = np.where(ranging.used, messages.density(points), 0)
        of_distance = np.log(density * messages.girth[:, :, None] + np.float32(1e-30))
        mixture = density.sum(axis=1) / np.maximum(ranging.used.sum(axis=1), 1)
        return (ranging.scores(of_distance).sum(axis=1) + self.rest.log_likelihood(points),
                np.log(mixture + np.float32(1e-30)))

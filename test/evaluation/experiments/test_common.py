"""What experiments share."""

import numpy as np
from tsmcl_ros.evaluation.experiments.common import follow, Parked
from tsmcl_ros.localizer import Localizer
from tsmcl_ros.world import make_world


def test_parked_vehicles_stay():
    parked = Parked(np.ones((2, 2)))

    assert parked.step(5.0).position.tolist() == [[1, 1], [1, 1]]


def test_the_first_vehicles_of_a_world_can_be_followed_alone():
    tracks = []
    for vehicles in (3, 6):
        world = make_world({'vehicles': 6, 'radio_range': 1000.0}, np.random.default_rng(1))
        localizer = Localizer({'method': 'grid', 'motion_model': 'random', 'grid_cell': 100.0,
                               'grid_x_max': 4000.0, 'grid_y_max': 4000.0}, vehicles)
        tracks.append(follow(world, localizer, 4, odometry=False).error)

    # The exact filter draws no random numbers, so company makes no difference.
    np.testing.assert_allclose(tracks[0], tracks[1][:, :3])

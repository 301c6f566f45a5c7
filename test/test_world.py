"""What radios hear against brute force and by hand; odometry and layouts by their statistics."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats
from tsmcl_ros.config import dump_yaml, parameters
from tsmcl_ros.model.mobility import State
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.model.radio_config import RadioConfig
from tsmcl_ros.model.relay import Poses, RelayConfig
from tsmcl_ros.types import ANCHOR, ConfigError, LogError, Observation, VEHICLE
from tsmcl_ros.world import (
    anchor_table,
    AnchorConfig,
    CONFIGS,
    lay_out,
    make_mobility,
    make_world,
    MOBILITY,
    receive,
    WheelOdometry,
    World,
    WorldConfig,
)

SIGNIFICANCE = 1e-3
HEADLINE = {'radio_range': 1000.0}

# Three vehicles on a line, and three anchors of which the middle one has an odd name.
VEHICLES = np.array([[0.0, 0.0], [100.0, 0.0], [900.0, 0.0]])
ANCHORS = anchor_table(np.array([[0.0, 30.0], [40.0, 0.0], [100.0, 50.0]]), np.array([5, 77, 6]))


def rng(seed: int = 1) -> np.random.Generator:
    return np.random.default_rng(seed)


def disk(radio_range: float = 60.0, **radio: object) -> Channel:
    return Channel(RadioConfig(radio_range=radio_range, **radio))  # type: ignore[arg-type]


def listen(channel: Channel, senders: Observation = ANCHORS, drop_rate: float = 0.0,
           position: np.ndarray = VEHICLES) -> Observation:
    return receive(channel, position, senders, rng(), 3.5, drop_rate)


def random_case(vehicles: int, anchors: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions of vehicles and anchors on a 1 km square, and all their distances."""
    draw = rng(7)
    position = draw.uniform(0, 1000, (vehicles, 2))
    place = draw.uniform(0, 1000, (anchors, 2)).astype(np.float32)
    return position, place, np.linalg.norm(position[:, None] - place, axis=2)


# What radios hear


def test_a_vehicle_hears_the_anchors_within_range_in_their_order() -> None:
    np.testing.assert_array_equal(listen(disk()).sender, [[5, 77], [77, 6], [-1, -1]])


def test_rows_carry_the_positions_that_senders_claim() -> None:
    heard = listen(disk())
    np.testing.assert_array_equal(heard.position[1], [[40.0, 0.0], [100.0, 50.0]])
    assert heard.position.dtype == np.float32


def test_rows_carry_the_radio_range_and_padding_does_not() -> None:
    np.testing.assert_array_equal(
        listen(disk()).max_range, [[60.0, 60.0], [60.0, 60.0], [np.nan, np.nan]])


def test_the_edge_of_the_disk_belongs_to_it() -> None:
    heard = listen(disk(50.0), position=np.array([[100.0, 0.0]]))
    np.testing.assert_array_equal(heard.sender, [[6]])


def test_what_a_radio_does_not_measure_is_nan() -> None:
    heard = listen(disk())
    assert np.isnan(heard.range).all()
    assert np.isnan(heard.range_std).all()
    assert np.isnan(heard.rssi).all()


def test_ranges_are_measured_with_their_deviation() -> None:
    heard = listen(disk(measure_range=True, range_std=1e-3))
    np.testing.assert_allclose(heard.range[:2], [[30.0, 40.0], [60.0, 50.0]], atol=0.01)
    np.testing.assert_allclose(heard.range_std[:2], 1e-3)


def test_rssi_is_measured_on_the_path_loss_curve() -> None:
    heard = listen(disk(measure_rssi=True, sigma_db=1e-6))
    np.testing.assert_allclose(heard.rssi[0], -40 - 20 * np.log10([30.0, 40.0]), atol=1e-3)


def test_kind_hops_and_covariance_of_senders_come_through() -> None:
    covariance = np.arange(12, dtype=np.float32).reshape(1, 3, 2, 2)
    sent = replace(ANCHORS, kind=np.array([[0, 1, 0]], np.uint8),
                   hops=np.array([[1, 2, 1]], np.uint8), covariance=covariance)
    heard = listen(disk(), sent)
    np.testing.assert_array_equal(heard.kind[0], [0, 1])
    np.testing.assert_array_equal(heard.hops[0], [1, 2])
    np.testing.assert_array_equal(heard.covariance[1], covariance[0, 1:])


def test_an_observation_bears_its_reception_time() -> None:
    assert listen(disk()).stamp == 3.5


def test_padded_rows_of_senders_are_not_sent() -> None:
    padded = Observation.stack([ANCHORS, anchor_table(np.zeros((9, 2)))], 0.0)
    first = replace(padded, **{
        name: getattr(padded, name)[:1]
        for name in ('sender', 'kind', 'hops', 'position', 'covariance', 'max_range', 'range',
                     'range_std', 'rssi')})
    np.testing.assert_array_equal(listen(disk(), first).sender, listen(disk()).sender)


def test_senders_in_three_dimensions_are_heard_in_the_plane() -> None:
    high = anchor_table(np.array([[0.0, 30.0, 500.0]]))
    heard = listen(disk(), high)
    assert heard.sender[0].tolist() == [0]
    assert heard.position.shape == (3, 1, 2)


def test_height_counts_in_three_dimensions() -> None:
    high = anchor_table(np.array([[0.0, 30.0, 40.0]]))
    vehicle = np.zeros((1, 3))
    assert listen(disk(50.0), high, position=vehicle).heard.all()
    assert listen(disk(49.9), high, position=vehicle).sender.shape == (1, 0)


def test_nobody_heard_gives_no_rows() -> None:
    assert listen(disk(1.0)).sender.shape == (3, 0)


def test_no_sender_gives_no_rows() -> None:
    assert listen(disk(), anchor_table(np.empty((0, 2)))).sender.shape == (3, 0)


def test_a_disk_without_a_radio_range_is_refused() -> None:
    with pytest.raises(ConfigError, match='radio_range'):
        listen(Channel(RadioConfig()))


def test_a_fleet_hears_what_all_pairs_of_distances_say() -> None:
    position, place, distance = random_case(2000, 300)
    heard = listen(disk(80.0), anchor_table(place), position=position)
    expected = [np.flatnonzero(row).tolist() for row in distance <= 80.0]
    assert [row[row >= 0].tolist() for row in heard.sender] == expected
    assert heard.sender.shape[1] == max(map(len, expected))
    np.testing.assert_array_equal(heard.position[heard.heard], place[heard.sender[heard.heard]])


def test_measurements_of_a_fleet_stand_in_the_rows_of_their_senders() -> None:
    position, place, distance = random_case(500, 300)
    heard = listen(disk(80.0, measure_range=True, range_std=1e-3), anchor_table(place),
                   position=position)
    vehicle, row = np.nonzero(heard.heard)
    np.testing.assert_allclose(
        heard.range[vehicle, row], distance[vehicle, heard.sender[vehicle, row]], atol=0.02)


def test_shadowed_beacons_are_heard_as_often_as_the_channel_says_at_any_distance() -> None:
    radio = {'radio_model': 'lognormal', 'sensitivity': -80.0, 'path_loss_exponent': 3.0}
    channel = Channel(RadioConfig(**radio))  # type: ignore[arg-type]
    position, place, distance = random_case(3000, 100)
    heard = listen(channel, anchor_table(place), position=position)
    mask = np.zeros(distance.shape, bool)
    vehicle, row = np.nonzero(heard.heard)
    mask[vehicle, heard.sender[vehicle, row]] = True
    chance = stats.norm.cdf(30 * np.log10(channel.radio_range / distance) / 4.0)
    for low, high in ((0, 10), (10, 20), (20, 30), (30, 50), (50, 100), (100, 1500)):
        ring = (distance >= low) & (distance < high)
        deviation = (mask[ring].sum() - chance[ring].sum()) / math.sqrt(
            (chance[ring] * (1 - chance[ring])).sum())
        assert abs(deviation) < 3.5


def test_lost_beacons_are_as_many_as_the_drop_rate_says() -> None:
    place = anchor_table(np.zeros((500, 2)))
    heard = listen(disk(), place, drop_rate=0.3, position=np.zeros((20, 2)))
    count = int(heard.heard.sum())
    assert stats.binomtest(count, 10_000, 0.7).pvalue > SIGNIFICANCE


def test_every_beacon_can_be_lost() -> None:
    assert listen(disk(), drop_rate=1.0).sender.shape == (3, 0)


# Odometry


def straight(yaw: float, vehicles: int = 1) -> Callable[[float], State]:
    """Return the states of vehicles that have driven some way in a direction from (7, 8)."""
    towards = np.array([math.cos(yaw), math.sin(yaw)])

    def after(way: float) -> State:
        position = np.tile([7.0, 8.0] + way * towards, (vehicles, 1))
        return State(position, np.tile(towards, (vehicles, 1)), np.full(vehicles, yaw))

    return after


def quiet(**settings: object) -> WorldConfig:
    return WorldConfig(odom_noise=0.0, **settings)  # type: ignore[arg-type]


def test_odometry_starts_at_zero() -> None:
    assert WheelOdometry(WorldConfig(), straight(1.0)(0), rng()).position.tolist() == [[0.0, 0.0]]


def test_faultless_odometry_tells_the_way_from_the_start() -> None:
    state = straight(1.0)
    odometry = WheelOdometry(quiet(), state(0), rng())
    odometry.step(state(3.0))
    position, yaw = odometry.step(state(5.0))
    np.testing.assert_allclose(position, [[5 * math.cos(1), 5 * math.sin(1)]])
    np.testing.assert_allclose(yaw, 1.0)


def test_with_the_heading_unknown_the_start_is_straight_ahead() -> None:
    state = straight(1.0)
    odometry = WheelOdometry(quiet(odom_heading='unknown'), state(0), rng())
    position, yaw = odometry.step(state(5.0))
    np.testing.assert_allclose(position, [[5.0, 0.0]], atol=1e-12)
    np.testing.assert_allclose(yaw, 0.0, atol=1e-12)


def test_height_is_not_rotated() -> None:
    def at(*position: float) -> State:
        return State(np.array([position]), np.zeros((1, 3)), np.full(1, math.pi / 2))

    odometry = WheelOdometry(quiet(odom_heading='unknown'), at(0, 0, 0), rng())
    np.testing.assert_allclose(odometry.step(at(0, 4, 3))[0], [[4.0, 0.0, 3.0]], atol=1e-12)


def test_odometry_noise_is_of_the_wanted_size_on_each_axis() -> None:
    state = straight(1.0, vehicles=4000)
    odometry = WheelOdometry(WorldConfig(odom_noise=0.5), state(0), rng())
    error = odometry.step(state(9.0))[0] - [9 * math.cos(1), 9 * math.sin(1)]
    for axis in range(2):
        assert stats.kstest(error[:, axis] / 0.5, 'norm').pvalue > SIGNIFICANCE


def test_odometry_errors_add_up_over_periods() -> None:
    state = straight(1.0, vehicles=4000)
    odometry = WheelOdometry(WorldConfig(odom_noise=0.5), state(0), rng())
    for _ in range(100):
        odometry.step(state(0))
    assert odometry.position.std() == pytest.approx(0.5 * math.sqrt(100), rel=0.05)


def test_a_vehicle_keeps_its_scale_error() -> None:
    state = straight(0.0, vehicles=2000)
    odometry = WheelOdometry(quiet(odom_scale_noise=0.1), state(0), rng())
    once = odometry.step(state(10.0))[0][:, 0].copy()
    assert (once / 10).std() == pytest.approx(0.1, rel=0.1)
    np.testing.assert_allclose(odometry.step(state(20.0))[0][:, 0], 2 * once)


def test_heading_drift_walks_randomly() -> None:
    state = straight(0.0, vehicles=2000)
    odometry = WheelOdometry(quiet(odom_yaw_noise=0.01), state(0), rng())
    for _ in range(100):
        odometry.step(state(0))
    assert odometry.yaw.std() == pytest.approx(0.1, rel=0.1)


def test_heading_drift_turns_displacements_too() -> None:
    state = straight(0.0, vehicles=50)
    odometry = WheelOdometry(quiet(odom_yaw_noise=0.1), state(0), rng())
    position, yaw = odometry.step(state(10.0))
    np.testing.assert_allclose(position, 10 * np.stack([np.cos(yaw), np.sin(yaw)], axis=1))


# Layouts


def test_a_grid_without_jitter_has_anchors_in_the_middle_of_its_cells() -> None:
    config = AnchorConfig(anchor_rows=2, anchor_columns=3, anchor_spacing=10.0, anchor_jitter=0.0,
                          anchor_origin_x=100.0)
    np.testing.assert_array_equal(lay_out(config, 2, rng()), [
        [105.0, 5.0], [115.0, 5.0], [125.0, 5.0], [105.0, 15.0], [115.0, 15.0], [125.0, 15.0]])


def test_jitter_moves_anchors_evenly_up_to_its_size() -> None:
    size = {'anchor_rows': 50, 'anchor_columns': 40}
    still = lay_out(AnchorConfig(anchor_jitter=0.0, **size), 2, rng())
    moved = lay_out(AnchorConfig(anchor_jitter=200.0, **size), 2, rng()) - still
    assert stats.kstest(moved.ravel(), stats.uniform(-200, 400).cdf).pvalue > SIGNIFICANCE


def test_uniform_anchors_fill_the_rectangle_of_the_grid() -> None:
    config = AnchorConfig(anchor_layout='uniform', anchor_rows=20, anchor_columns=100,
                          anchor_spacing=10.0)
    position = lay_out(config, 2, rng())
    assert position.shape == (2000, 2)
    for axis, size in enumerate((1000, 200)):
        assert stats.kstest(position[:, axis], stats.uniform(0, size).cdf).pvalue > SIGNIFICANCE


def test_in_three_dimensions_anchors_stand_at_all_heights() -> None:
    config = AnchorConfig(anchor_rows=40, anchor_columns=50, anchor_height=30.0)
    height = lay_out(config, 3, rng())[:, 2]
    assert stats.kstest(height, stats.uniform(0, 30).cdf).pvalue > SIGNIFICANCE


def test_listed_anchors_stand_where_the_list_says() -> None:
    config = AnchorConfig(anchor_layout='list', anchor_positions=('1 2', '3.5 -4 5'))
    np.testing.assert_array_equal(lay_out(config, 2, rng()), [[1.0, 2.0], [3.5, -4.0]])
    np.testing.assert_array_equal(lay_out(config, 3, rng()), [[1.0, 2.0, 0.0], [3.5, -4.0, 5.0]])


@pytest.mark.parametrize('text', ['', '1', '1 2 3 4', 'a b', 'nan 1', '1,2'])
def test_a_listed_anchor_that_is_no_position_is_refused(text) -> None:
    config = AnchorConfig(anchor_layout='list', anchor_positions=('0 0', text))
    with pytest.raises(ConfigError, match=f"anchor_positions: '{text}' is not allowed"):
        lay_out(config, 2, rng())


def test_an_empty_list_of_anchors_is_refused() -> None:
    with pytest.raises(ConfigError, match=r'anchor_positions: \(\) is not allowed'):
        lay_out(AnchorConfig(anchor_layout='list'), 2, rng())


# The whole


def drive(seed: int, periods: int = 20, **settings: object) -> list:
    world = make_world({**HEADLINE, **settings}, rng(seed))
    return [world.step() for _ in range(periods)]


def test_the_headline_has_forty_vehicles_among_sixteen_anchors_by_default() -> None:
    world = make_world(HEADLINE, rng())
    assert world.mobility.state.position.shape == (40, 2)
    assert world.anchors.sender.tolist() == [list(range(16))]


def test_headline_vehicles_hear_as_many_anchors_as_their_density_says() -> None:
    # Bettstetter's approximation of where random-waypoint vehicles are, good to some percent:
    # a parabola on each axis.
    world = make_world({**HEADLINE, 'vehicles': 4000}, rng())
    place = world.anchors.position[0]
    typical = 4000.0 * rng(2).beta(2, 2, (50_000, 1, 2))
    expected = 16 * np.mean(np.linalg.norm(typical - place, axis=2) <= 1000.0)
    assert 2.7 < expected < 3.1
    heard = [world.step().observation.heard.sum(axis=1).mean() for _ in range(5)]
    assert np.mean(heard) == pytest.approx(expected, rel=0.03)


def test_headline_odometry_errs_by_half_a_metre_a_step() -> None:
    epochs = drive(1, 100)
    told = np.diff([epoch.odom_position for epoch in epochs], axis=0)
    true = np.diff([epoch.position for epoch in epochs], axis=0)
    assert stats.kstest(((told - true) / 0.5).ravel(), 'norm').pvalue > SIGNIFICANCE


def test_epochs_come_a_period_apart_without_adding_up_rounding() -> None:
    stamps = [epoch.stamp for epoch in drive(1, 1000, beacon_period=0.1, vehicles=1)]
    np.testing.assert_allclose(stamps, np.arange(1, 1001) / 10, rtol=1e-15)


def test_an_epoch_holds_what_its_vehicles_hear_where_they_then_are() -> None:
    epoch = drive(1, 5)[-1]
    delta = epoch.position[:, None] - epoch.observation.position
    distance = np.linalg.norm(delta, axis=2)[epoch.observation.heard]
    assert distance.max() <= 1000.0
    assert epoch.observation.stamp == epoch.stamp == 5.0


def test_the_same_seed_gives_the_same_bits() -> None:
    radio = {'measure_range': True, 'measure_rssi': True, 'drop_rate': 0.1}
    for one, other in zip(drive(3, **radio), drive(3, **radio), strict=True):
        for name in ('position', 'velocity', 'yaw', 'odom_position', 'odom_yaw'):
            assert getattr(one, name).tobytes() == getattr(other, name).tobytes()
        for name in ('sender', 'position', 'range', 'rssi'):
            heard = getattr(one.observation, name), getattr(other.observation, name)
            assert heard[0].tobytes() == heard[1].tobytes()


def test_the_radio_changes_neither_ways_nor_odometry() -> None:
    one, other = drive(3)[-1], drive(3, drop_rate=0.5, measure_range=True)[-1]
    np.testing.assert_array_equal(one.position, other.position)
    np.testing.assert_array_equal(one.odom_position, other.odom_position)


def test_a_world_hears_what_was_really_transmitted_if_told() -> None:
    world = make_world({'radio_range': 1e5}, rng())
    sent = anchor_table(np.array([[2000.0, 2000.0, 0.0]]), np.array([9]))
    assert world.step(sent).observation.sender.tolist() == [[9]] * 40


def test_a_world_can_begin_at_any_time() -> None:
    config = WorldConfig(vehicles=2)
    mobility = make_mobility({'vehicles': 2}, rng())
    world = World(config, disk(), mobility, ANCHORS, rng(), stamp=100.0)
    assert world.step().stamp == 101.0


def test_a_world_in_three_dimensions_is_so_throughout() -> None:
    world = make_world({**HEADLINE, 'area_z': 500.0, 'anchor_height': 500.0}, rng())
    epoch = world.step()
    assert epoch.odom_position.shape == (40, 3)
    assert epoch.observation.position.shape[2] == 3


def test_the_cars_of_the_sumo_trace_drive_in_the_world(shared_data) -> None:
    trace = shared_data / 'sumo_grid40' / 'fcd40.xml.gz'
    world = make_world({**HEADLINE, 'mobility': 'fcd', 'trace': str(trace)}, rng())
    for _ in range(259):
        epoch = world.step()
    assert epoch.position.shape == (40, 2)
    assert epoch.observation.heard.any(axis=1).all()
    with pytest.raises(LogError, match='300 s is not in it, it lasts from 40 s to 299 s'):
        world.step()


def test_every_mobility_is_made_from_documented_parameters() -> None:
    for config, _ in MOBILITY.values():
        assert parameters(config)


def test_no_parameter_of_the_world_is_declared_twice() -> None:
    names = [item.name for config in CONFIGS for item in parameters(config)]
    assert len(names) == len(set(names))


def test_the_defaults_of_the_world_can_be_dumped() -> None:
    assert 'anchor_spacing: 1000.0' in dump_yaml(*(config() for config in CONFIGS))


# Vehicles as senders


def known(mean: np.ndarray, stamp: float = 0.0, std: float = 1.0) -> Poses:
    vehicles, dimension = mean.shape
    return Poses(np.full(vehicles, stamp), mean.copy(),
                 np.tile(std ** 2 * np.eye(dimension), (vehicles, 1, 1)))


def standing(position: np.ndarray = VEHICLES, reach: float = 150.0, anchors: Observation = ANCHORS,
             relay_hops: int = 1, spread: float = 1.0, **settings: object) -> World:
    """Return a world in which nobody moves."""
    still = SimpleNamespace(state=State(
        position, np.zeros_like(position), np.zeros(len(position))), duration=math.inf)
    still.step = lambda elapsed: still.state
    radio = {name: settings.pop(name) for name in ('measure_range', 'range_std')
             if name in settings}
    return World(WorldConfig(vehicles=len(position), **settings), disk(reach, **radio), still,
                 anchors, rng(),
                 relaying=RelayConfig(relay_hops=relay_hops, pose_max_spread=spread))


def heard_of_vehicles(observation: Observation) -> list[list[int]]:
    rows = observation.heard & (observation.kind == VEHICLE)
    return [(senders[used] - 1_000_000).tolist()
            for senders, used in zip(observation.sender, rows, strict=True)]


def test_a_vehicle_hears_the_poses_of_others_in_range_and_never_its_own() -> None:
    epoch = standing().step(poses=known(VEHICLES + 5))
    assert heard_of_vehicles(epoch.observation) == [[1], [0], []]


def test_a_fleet_hears_the_poses_of_all_others_in_range() -> None:
    position, place, distance = random_case(500, 300)
    heard = standing(position, 80.0, anchor_table(place)).step(poses=known(position)).observation
    near = np.linalg.norm(position[:, None] - position, axis=2) <= 80.0
    np.fill_diagonal(near, False)
    offset = RelayConfig().vehicle_id_offset
    expected = [np.append(np.flatnonzero(anchors), offset + np.flatnonzero(vehicles)).tolist()
                for anchors, vehicles in zip(distance <= 80.0, near, strict=True)]
    assert [row[row >= 0].tolist() for row in heard.sender] == expected


def test_a_vehicle_claims_where_it_believes_to_be_and_is_heard_from_where_it_is() -> None:
    world = standing(measure_range=True, range_std=1e-3, odom_noise=0.0)
    observation = world.step(poses=known(VEHICLES + [0, 7000])).observation
    row = observation.kind[0].tolist().index(VEHICLE)
    np.testing.assert_array_equal(observation.position[0, row], [100.0, 7000.0])
    np.testing.assert_allclose(observation.range[0, row], 100.0, atol=0.01)


def test_cooperation_changes_nothing_of_what_is_heard_of_anchors() -> None:
    settings = {**HEADLINE, 'measure_range': True, 'drop_rate': 0.2}
    alone, together = (make_world(settings, rng()) for _ in range(2))
    for _ in range(3):
        one = alone.step()
        other = together.step(poses=known(one.position, one.stamp - 1)).observation
        anchors = replace(other, sender=np.where(other.kind == VEHICLE, -1, other.sender))
        for name in ('sender', 'range', 'position'):
            assert getattr(Observation.join([anchors]), name).tobytes() == (
                getattr(one.observation, name).tobytes())


def test_a_pose_is_moved_by_odometry_whose_noise_is_added_for_each_period() -> None:
    state = straight(0.0)
    moving = SimpleNamespace(state=state(0.0), way=0.0, duration=math.inf)

    def step(elapsed: float) -> State:
        moving.way += 3.0 * elapsed
        return State(np.concatenate([state(moving.way).position, [[0.0, 0.0]]]),
                     np.zeros((2, 2)), np.zeros(2))

    moving.step, moving.state = step, step(0.0)
    world = World(WorldConfig(vehicles=2, odom_noise=0.5, odom_scale_noise=0.1), disk(100.0),
                  moving, ANCHORS, rng())
    odometry = [world.step().odom_position for _ in range(3)]
    observation = world.step(poses=known(np.array([[50.0, 60.0], [0.0, 0.0]]), 2.0)).observation
    row = observation.kind[1].tolist().index(VEHICLE)
    way = world._odometry.position[0] - odometry[1][0]
    np.testing.assert_allclose(observation.position[1, row], [50, 60] + way, rtol=1e-6)
    expected = 1 + 2 * 0.5 ** 2 + (0.1 * np.linalg.norm(way)) ** 2
    np.testing.assert_allclose(observation.covariance[1, row], expected * np.eye(2), rtol=1e-6)


def test_poses_between_two_periods_are_moved_by_interpolated_odometry() -> None:
    world = make_world({**HEADLINE, 'vehicles': 2, 'radio_range': 1e4}, rng())
    way = [np.zeros((2, 2)), world.step().odom_position]
    way.append(world.step(poses=known(np.zeros((2, 2)), 0.75)).odom_position)
    told = world._up_to_date(known(np.zeros((2, 2)), 0.75), 2.0).mean
    np.testing.assert_allclose(told, way[2] - (0.25 * way[0] + 0.75 * way[1]))


def test_without_a_common_heading_a_pose_stays_and_may_be_as_far_off_as_a_vehicle_drives() -> None:
    world = standing(odom_heading='unknown')
    observation = world.step(poses=known(VEHICLES)).observation
    row = observation.kind[0].tolist().index(VEHICLE)
    np.testing.assert_array_equal(observation.position[0, row], VEHICLES[1])
    # A disk of radius R has a variance of R^2 / 4 along each axis.
    np.testing.assert_allclose(observation.covariance[0, row], (1 + 50.0 ** 2 / 4) * np.eye(2))


@pytest.mark.parametrize(('stamp', 'told'), [(-2.0, True), (-2.5, False), (0.5, True),
                                             (1.5, False), (np.nan, False)])
def test_poses_of_the_last_periods_are_broadcast(stamp: float, told: bool) -> None:
    epoch = standing().step(poses=known(VEHICLES, stamp))
    assert heard_of_vehicles(epoch.observation) == ([[1], [0], []] if told else [[], [], []])


def test_who_is_lost_does_not_broadcast() -> None:
    poses = known(VEHICLES)
    poses.mean[0] = np.nan
    poses.covariance[1] *= 150.0 ** 2
    assert heard_of_vehicles(standing().step(poses=poses).observation) == [[], [], []]


def test_who_is_less_certain_than_asked_for_does_not_broadcast() -> None:
    poses = known(VEHICLES, std=10.0)  # on each of two axes, 14.2 m with a period's odometry
    for spread, told in ((0.09, []), (0.1, [1])):
        observation = standing(spread=spread).step(poses=poses).observation
        assert heard_of_vehicles(observation)[0] == told


def test_vehicles_relay_anchors_with_poses_or_without() -> None:
    far = anchor_table(np.array([[-60.0, 0.0], [160.0, 0.0], [900.0, 0.0]]))
    for poses in (None, known(VEHICLES)):
        heard = standing(reach=120.0, anchors=far, relay_hops=2).step(poses=poses).observation
        anchors = heard.heard & (heard.kind == ANCHOR)
        rows = [dict(zip(heard.sender[i, anchors[i]].tolist(), heard.hops[i, anchors[i]].tolist(),
                         strict=True)) for i in range(3)]
        assert rows == [{0: 1, 1: 2}, {1: 1, 0: 2}, {2: 1}]


def test_lost_beacons_of_vehicles_are_as_many_as_the_drop_rate_says() -> None:
    place = np.zeros((60, 2))
    heard = standing(place, drop_rate=0.3).step(poses=known(place)).observation
    count = sum(map(len, heard_of_vehicles(heard)))
    assert stats.binomtest(count, 60 * 59, 0.7).pvalue > SIGNIFICANCE


def test_a_vehicle_that_has_the_identity_of_an_anchor_is_refused() -> None:
    world = standing(anchors=anchor_table(np.zeros((1, 2)), np.array([1_000_002])))
    world.step()
    with pytest.raises(ConfigError, match='vehicle_id_offset: 1000000 is not allowed'):
        world.step(poses=known(VEHICLES))


# How often vehicles want beacons


def test_a_vehicle_that_asks_for_few_beacons_drives_on_without_them() -> None:
    settings = {'vehicles': 2, 'anchor_rows': 2, 'anchor_columns': 2, 'radio_range': 1e5}
    world, other = (make_world(settings, rng(3)) for _ in range(2))
    heard = []
    for period in range(9):
        epoch, free = world.step(), other.step()
        np.testing.assert_array_equal(epoch.position, free.position)
        heard.append(epoch.observation.heard.sum(axis=1).tolist())
        if period == 0:
            world.schedule.ask(1, 4)
    assert heard == [[4, 4], *[[4, 0]] * 3, [4, 4], *[[4, 0]] * 3, [4, 4]]
    assert world.schedule.localizations.tolist() == [36, 12]

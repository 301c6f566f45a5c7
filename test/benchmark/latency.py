"""
What a message costs on its way through a localizer node, and how long a fleet's process keeps up.

    python test/benchmark/run.py latency

Real processes over DDS, on this host's loopback and in a domain of their own.
"""

from __future__ import annotations

from pathlib import Path
from statistics import median
import tempfile

from goals import Goal, Section
import numpy as np
from processes import anchor_map, Process, ros, scans, Traffic

# Hz, beacon epochs of one vehicle: as wanted, and so slow that nothing queues.
RATE, CALM = 1500.0, 100.0
PERIOD = 0.1  # s, of simulated time between two of them: stamps go on faster than time does
ROUNDS, SETTLING = 3, 50
EPOCHS = {RATE: 1500, CALM: 300}  # in a round
SETTINGS = {'min_particles': 100, 'max_particles': 100, 'range_std': 2.0}
FLEET, FLEET_RATE, FLEET_EPOCHS = 200, 10.0, 80
ANCHORS = np.array([[x, y] for x in (0.0, 500.0, 1000.0) for y in (0.0, 800.0)])
SCRIPTS = Path(__file__).parent


def measure() -> Section:
    """Measure a lone vehicle's node beside an echo, then a fleet's process."""
    with ros():
        lone, lone_goals = _lone()
        fleet, fleet_goals = _fleet()
    return Section(
        'Message path',
        f'One vehicle with six anchors ranged in each epoch and without odometry; stamps are '
        f'{PERIOD:g} s apart at any rate. The localizer has {SETTINGS["max_particles"]} particles '
        'and otherwise its defaults, the method among them. The echo takes the same messages raw '
        'on the same executor and publishes a pose of constant bytes with the same quality of '
        'service. Processor time is that of all '
        "threads of a process, DDS's among them; the filter's is that of `Core.epoch` in "
        'the node, and the message path is the rest. Echo and node run in turn, medians of '
        f'{ROUNDS} rounds. Latency is from beacon sent to pose received; at {RATE:,g} Hz it is '
        'that of a queue where an epoch takes longer than its time.\n\n'
        f'The fleet: {FLEET} vehicles of one `fleet` process with its default method and '
        f'particles, kept to one core, whose beacons come in one burst {FLEET_RATE:g} times a '
        'second.', [lone, fleet], [*lone_goals, *fleet_goals])


def _lone() -> tuple[list[list[str]], list[Goal]]:
    """Return the table and the goals of one vehicle."""
    arguments = [word for name, value in SETTINGS.items() for word in ('-p', f'{name}:={value}')]
    with tempfile.NamedTemporaryFile() as file:
        filtering = np.memmap(file.name, float, 'w+', shape=1)
        processes = [
            Process(f'{SCRIPTS}/echo.py', '/echo/beacons', '/echo/pose'),
            Process(f'{SCRIPTS}/timed_localizer.py', file.name, '--ros-args',
                    '-r', '__ns:=/node', *arguments)]
        traffic = Traffic(['/echo', '/node'])
        traffic.settle(anchor_map(ANCHORS))
        # Of each round processor time an epoch, that of the filter, latencies [us]; what is lost.
        found: dict[tuple[float, int], list[list[float]]] = {}
        epochs = iter(scans(ANCHORS, 1, SETTLING + ROUNDS * sum(EPOCHS.values()), PERIOD))
        rounds = [(CALM, SETTLING), *list(EPOCHS.items()) * ROUNDS]
        for number, (rate, count) in enumerate(rounds):
            some = [next(epochs) for _ in range(count)]
            for which, process in enumerate(processes):
                before = process.cpu, float(filtering[0])
                answers = traffic.send([[(which, data)] for data, in some], rate)
                done = 1e-6 * max(count - answers.lost, 1)
                if number:
                    found.setdefault((rate, which), []).append([
                        (process.cpu - before[0]) / done, (float(filtering[0]) - before[1]) / done,
                        *(1e6 * value for value in answers.percentiles), answers.lost])
        for process in processes:
            process.stop()
        traffic.close()
    return _judge(found)


def _judge(found: dict[tuple[float, int], list[list[float]]]
           ) -> tuple[list[list[str]], list[Goal]]:
    rows = [['one vehicle', 'CPU us an epoch', 'of it filter', 'message path',
             'latency us, median', 'p99', 'lost']]
    medians = {}
    for rate in EPOCHS:
        for which, name in enumerate(('echo', 'node')):
            rounds = found[rate, which]
            cpu, filtering, middle, most, _ = (
                median(values) for values in zip(*rounds, strict=True))
            path = median(each[0] - each[1] for each in rounds)
            medians[rate, name] = cpu, path, most
            lost = sum(int(each[-1]) for each in rounds)
            rows.append([
                f'{name}, {rate:,g} Hz', f'{cpu:.0f}', f'{filtering:.0f}', f'{path:.0f}',
                f'{middle:.0f}', f'{most:.0f}', f'{lost} of {ROUNDS * EPOCHS[rate]}'])
    wanted, calm = ([a / b for a, b in zip(medians[rate, 'node'], medians[rate, 'echo'],
                                           strict=True)] for rate in (RATE, CALM))
    filtering = medians[RATE, 'node'][0] - medians[RATE, 'node'][1]
    reason = (f'the filter alone takes {filtering / medians[RATE, "echo"][0]:.1f} times the '
              'echo: what numpy takes for a call, some hundred times an epoch, for one vehicle')
    return rows, [
        Goal(f'CPU of the localizer node an epoch at {RATE:,g} Hz, against an echo', wanted[0],
             1.5, reason=f'{reason}.'),
        Goal('its message path alone, against an echo', wanted[1], 1.5,
             reason='By py-spy a third of it is decoding and checking the beacons, a quarter '
             'encoding and publishing the pose, the rest queues and the question whether all '
             'that belongs to an epoch is there. The echo does nothing but publish.'),
        Goal(f'p99 of latency from beacon to pose at {RATE:,g} Hz, against an echo', wanted[2],
             1.5, reason=f'{reason}; from {1e6 / RATE:.0f} us an epoch on, beacons queue.'),
        Goal(f'the same at {CALM:g} Hz', calm[2], 1.5, reason=f'{reason}.'),
    ]


def _fleet() -> tuple[list[list[str]], list[Goal]]:
    """Return the table and the goals of a fleet's process."""
    starts = []
    for number in range(ROUNDS):
        process = Process('-m', 'tsmcl_ros.nodes.fleet', '--ros-args', '-p',
                          f'vehicles:={FLEET}', core=0)
        starts.append(process.start)
        if number < ROUNDS - 1:
            process.stop()
    start = median(starts)
    traffic = Traffic([f'/veh_{vehicle}' for vehicle in range(FLEET)])
    traffic.settle(anchor_map(ANCHORS))
    bursts = [list(enumerate(epoch))
              for epoch in scans(ANCHORS, FLEET, 10 + FLEET_EPOCHS, 1 / FLEET_RATE)]
    # Finding all vehicles anywhere takes longer than any later epoch.
    traffic.send(bursts[:10], FLEET_RATE, quiet=20.0)
    before = process.cpu
    answers = traffic.send(bursts[10:], FLEET_RATE)
    needed = (process.cpu - before) * FLEET_RATE / FLEET_EPOCHS
    memory, peak = process.memory
    process.stop()
    traffic.close()
    middle, most = answers.percentiles
    rows = [[f'{FLEET} vehicles', 'cores that it needs', 'latency ms, median', 'p99', 'lost',
             'memory MB', 'at its most', f'start s, median of {ROUNDS}'],
            ['fleet', f'{needed:.2f}', f'{1e3 * middle:.0f}', f'{1e3 * most:.0f}',
             f'{answers.lost} of {FLEET * FLEET_EPOCHS}', f'{memory:.0f}',
             f'{peak:.0f}', f'{start:.2f}']]
    return rows, [
        Goal(f'epochs lost by a fleet of {FLEET} at {FLEET_RATE:g} Hz on one core',
             answers.lost, 0),
        Goal('its median latency, which tells whether it keeps up', 1e3 * middle,
             1e3 / FLEET_RATE, unit='ms',
             reason=f'it would need {needed:.1f} cores. By py-spy 48 % of its time are the '
             'update (41 % the search), 26 % taking beacons in, one message a vehicle, 4 % '
             'publishing.'),
        Goal('its memory', memory, 150, unit='MB',
             reason='The interpreter with numpy and rclpy takes 70 MB, a vehicle 0.35 MB.'),
        Goal('its start until it is active', start, 2, unit='s',
             reason='A second of it are imports, the rest three topics a vehicle.'),
    ]

"""
What lying and broken anchors do to vehicles that hear six, one or two of which lie.

    python test/reliability/run.py liars

Anchors stand on a jittered grid and radios reach so far that a vehicle hears six of them in the
mean. Every sixth of the grid lies (every third: two of six), from the start or from when vehicles
know their place, and what is heard otherwise is the same, epoch by epoch, as in the clean run
beside it. Nobody has a map, so that nothing but what is heard tells who lies; once more with one.
Who is told from the start who lies, and does not listen to them, has lost what they could have
said: nobody can be expected to do better than that.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from goals import Goal, Section
import numpy as np
from tsmcl_ros.config import build
from tsmcl_ros.localizer import Localizer
from tsmcl_ros.model.health import OK
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.model.radio_config import RadioConfig
from tsmcl_ros.types import Array, Observation, PADDED
from tsmcl_ros.world import Epoch, make_world, receive

SEED = 11
VEHICLES, EPOCHS, KNOWN, SETTLED = 20, 100, 40, 15
CLEAN_VEHICLES, CLEAN = 5, 1000
ROWS, SPACING = 8, 1000.0
# A disk of this radius holds six anchors of the grid in the mean.
REACH = SPACING * (6 / np.pi) ** 0.5
WORLD = {
    'anchor_rows': ROWS, 'anchor_columns': ROWS, 'anchor_spacing': SPACING,
    'anchor_origin_x': -2000.0, 'anchor_origin_y': -2000.0, 'odom_noise': 0.5,
    'radio_range': REACH}
KINDS = {
    'ranges': {'measure_range': True, 'range_std': 2.0},
    'range-free': {},
}
METHODS = ('ts_mcl', 'r_mcl', 'cooperative', 'ekf')
# As config/range_free.yaml has it.
RANGE_FREE = {
    'ts_mcl': {'edge_softness': 1.0, 'alpha3': 0.0, 'aspiration': 0.9, 'prior_bandwidth': 0.2}}
MOVES = 20.0  # m an epoch
DELAY = 20  # epochs


REASONS = {
    'ranges': 'Where a third lies some vehicles hear half and more of it, and have no majority to '
    'go by; replays agree with each other, too, on where they were.',
    'range-free': 'One disk in six less already costs what column "told" shows. Beyond that: a '
    'disk is wide, and as long as all that a vehicle hears meets somewhere, nothing tells the '
    'lie; it costs the vehicles that have not crossed many edges.',
}
LIES = {
    'offset': 'claims to be 2 R away',
    'moving': f'claims to move, {MOVES:g} m an epoch',
    'replay': f'says what was heard of it {DELAY} epochs ago',
    'twin': 'another sender, 2 R away, uses its id and claims its place',
}
# And one that says nothing from the start.
NOTHING = 'nothing'
# With and without a map, which tells those who claim another place, and no others.
TRIED = [*((lie, False) for lie in LIES), ('offset', True), ('moving', True)]
# What is wanted of those who hear one of how many lie, or of some of their estimates.
GOALS = (
    ('1 of 6', 6, '', 1.2),
    ('2 of 6, of vehicles that heard an honest majority', 3, 'majority', 2.0),
    ('2 of 6, of epochs shown as OK', 3, 'ok', 2.0),
)


@dataclass(frozen=True)
class Case:
    """Who is to stand which lie, of one anchor in `every`, from which epoch on."""

    kind: str
    method: str
    lie: str = ''
    every: int = 6
    begin: int = KNOWN
    mapped: bool = False


class Air:
    """The epochs of a world, in which some anchors lie."""

    def __init__(self, case: Case, seed: int, vehicles: int) -> None:
        """Make a world and choose who lies."""
        settings = WORLD | KINDS[case.kind] | {'vehicles': vehicles}
        self.world = make_world(settings, np.random.default_rng(seed))
        self._case = case
        row, column = np.divmod(np.arange(ROWS * ROWS), ROWS)
        # Evenly spread over the grid.
        self.liars = np.flatnonzero((column + 2 * row) % case.every == 0)
        self._channel = Channel(build(RadioConfig, settings))
        self._rng = np.random.default_rng(seed)
        angle = self._rng.uniform(0, 2 * np.pi, len(self.liars))
        self._way = np.stack([np.cos(angle), np.sin(angle)], axis=1).astype(np.float32)
        self._said: list[Observation] = []

    def step(self) -> tuple[Epoch, Observation, Array]:
        """Return the epoch, what is heard in it, and which rows (V, K) bool of that are lies."""
        epoch, case = self.world.step(), self._case
        heard = epoch.observation
        theirs = np.isin(heard.sender, self.liars)
        self._said.append(heard)
        since = len(self._said) - case.begin
        if not case.lie or since <= 0:
            return epoch, heard, np.zeros_like(theirs)
        if case.lie == NOTHING:
            rest = replace(heard, sender=np.where(theirs, PADDED, heard.sender))
            return epoch, rest, np.zeros_like(rest.heard)
        if case.lie == 'offset':
            return epoch, self._shifted(heard, theirs, 2 * REACH), theirs
        if case.lie == 'moving':
            return epoch, self._shifted(heard, theirs, MOVES * since), theirs
        if case.lie == 'replay':
            return epoch, *self._replayed(heard, theirs)
        return epoch, *self._twice(heard, epoch.position)

    def _shifted(self, heard: Observation, theirs: Array, distance: float) -> Observation:
        """Return it with some rows' claims so far off [m]."""
        index = np.searchsorted(self.liars, np.where(theirs, heard.sender, self.liars[0]))
        return replace(heard, position=np.where(
            theirs[:, :, None], heard.position + np.float32(distance) * self._way[index],
            heard.position))

    def _replayed(self, heard: Observation, theirs: Array) -> tuple[Observation, Array]:
        """Return it with old rows in place of some."""
        old = self._said[max(len(self._said) - 1 - DELAY, 0)]
        then = replace(old, sender=np.where(
            np.isin(old.sender, self.liars), old.sender, PADDED))
        rest = replace(heard, sender=np.where(theirs, PADDED, heard.sender))
        whole = rest.followed_by([then.rows()])
        return whole, np.isin(whole.sender, self.liars)

    def _twice(self, heard: Observation, position: Array) -> tuple[Observation, Array]:
        """Return it with the rows of second senders."""
        table = self.world.anchors.columns(self.liars)
        there = replace(
            table, position=table.position + np.float32(2 * REACH) * self._way[0])
        second = receive(self._channel, position, there, self._rng, heard.stamp)
        index = np.searchsorted(self.liars, np.where(second.heard, second.sender, self.liars[0]))
        second = replace(second, position=table.position[0, index])
        whole = heard.followed_by([second.rows()])
        before = heard.heard.sum(axis=1)[:, None]
        return whole, whole.heard & (np.arange(whole.sender.shape[1]) >= before)


@dataclass(frozen=True)
class Run:
    """
    What came of a case.

    Attributes
    ----------
    error : (T, V) float
        [m].
    ok : (T, V) bool
        Whether the estimate was shown as OK.
    majority : (T, V) bool
        Whether most of what a vehicle heard was honest, in this epoch and in all before.
    named : list of int
        Lies that vehicles had heard of a liar when they named it.
    unnamed : int
        Liars that were heard ten times and more, each by a vehicle that never named it.
    honest : int
        Pairs of a vehicle and an honest anchor that it named.

    """

    error: Array
    ok: Array
    majority: Array
    named: list[int]
    unnamed: int
    honest: int

    def rmse(self, begin: int, which: Array | None = None) -> float:
        """
        Return the RMSE from an epoch on [m] of all estimates, or of some (T, V) bool.

        Who has no place yet has no error.
        """
        error = self.error if which is None else np.where(which, self.error, np.nan)
        return float(np.sqrt(np.nanmean(error[begin:] ** 2)))

    def growth(self, clean: Run, begin: int, of: str = '') -> float:
        """Return by what the RMSE has grown, of all estimates or those that an attribute names."""
        which = getattr(self, of) if of else None
        return self.rmse(begin, which) / clean.rmse(begin, which)


def run(case: Case, seed: int, vehicles: int = VEHICLES, epochs: int = EPOCHS) -> Run:
    """Drive through a case."""
    air = Air(case, seed, vehicles)
    settings = {'radio_range': REACH, 'method': case.method, 'seed': seed, 'odom_std': 0.5,
                'silence': 'memory', 'motion_model': 'odometry', 'odom_heading': 'known'}
    if case.kind == 'range-free':
        settings |= RANGE_FREE.get(case.method, {})
    localizer = Localizer(settings, vehicles)
    if case.mapped:
        localizer.anchor_map(air.world.anchors)
    error = np.zeros((epochs, vehicles))
    ok, majority = np.zeros((2, epochs, vehicles), bool)
    lied: dict[tuple[int, int], int] = {}
    named: dict[tuple[int, int], int] = {}
    honest = set()
    for number in range(epochs):
        epoch, observation, lies = air.step()
        estimate = localizer.epoch(observation, epoch.odom_position, epoch.odom_yaw)
        error[number] = np.linalg.norm(estimate.mean - epoch.position, axis=1)
        ok[number] = localizer.health.status == OK
        majority[number] = 2 * lies.sum(axis=1) < np.maximum(observation.heard.sum(axis=1), 1)
        for vehicle, row in np.argwhere(lies).tolist():
            pair = vehicle, int(observation.sender[vehicle, row])
            lied[pair] = lied.get(pair, 0) + 1
        for vehicle, suspects in enumerate(localizer.health.suspects):
            for sender in suspects:
                pair = vehicle, sender
                if pair in lied:
                    named.setdefault(pair, lied[pair])
                else:
                    honest.add(pair)
    unnamed = sum(pair not in named and count >= 10 for pair, count in lied.items())
    return Run(error, ok, np.logical_and.accumulate(majority), list(named.values()), unnamed,
               len(honest))


def measure() -> Section:
    """Run all methods through all lies."""
    head = ['method', 'hears', 'RMSE, clean', 'told', 'told, 2 of 6', 'lie', '1 of 6',
            'from the start', '2 of 6', 'from the start', 'named within 10', 'later', 'never',
            'honest named']
    rows, goals = [head], []
    for kind in KINDS:
        for method in METHODS:
            case = Case(kind, method)
            clean = run(case, SEED)
            told = [run(replace(case, lie=NOTHING, every=every, begin=0), SEED).growth(
                clean, SETTLED) for every in (6, 3)]
            worst = dict.fromkeys(GOALS, 0.0)
            caught = [0, 0]
            for lie, mapped in TRIED:
                ratios, runs = [], []
                for every in (6, 3):
                    for begin in (KNOWN, 0):
                        tried = run(Case(kind, method, lie, every, begin, mapped), SEED)
                        since = max(begin, SETTLED)
                        ratios.append(tried.growth(clean, since))
                        runs.append(tried)
                        for goal in GOALS:
                            if goal[1] == every:
                                worst[goal] = max(
                                    worst[goal], tried.growth(clean, since, goal[2]))
                soon = sum(count <= 10 for tried in runs for count in tried.named)
                late = sum(len(tried.named) for tried in runs) - soon
                never = sum(tried.unnamed for tried in runs)
                caught[0] += soon
                caught[1] += soon + late + never
                rows.append([
                    method, kind, f'{clean.rmse(SETTLED):.2f} m',
                    *(f'{ratio:.2f}' for ratio in told), lie + ', map' * mapped,
                    *(f'{ratio:.2f}' for ratio in ratios), f'{soon}', f'{late}', f'{never}',
                    f'{sum(tried.honest for tried in runs)}'])
            slandered = run(case, SEED, CLEAN_VEHICLES, CLEAN).honest
            what = f'{method}, {kind}'
            goals += [
                *(Goal(f'{what}: worst RMSE with {goal[0]}, of that of the clean run',
                       worst[goal], goal[3], reason=REASONS[kind]) for goal in GOALS),
                Goal(f'{what}: liars named within 10 lies', 100 * caught[0] / caught[1], 100,
                     'at least', '%', REASONS[kind]),
                Goal(f'{what}: honest anchors named in {CLEAN} clean epochs', slandered, 0),
            ]
    lies = '; '.join(f'{name}: {text}' for name, text in LIES.items())
    return Section(
        'Lying anchors', f'{VEHICLES} vehicles, {EPOCHS} epochs, {ROWS * ROWS} anchors, six of '
        'which are heard in the mean. RMSE over that of the clean run, of lies that begin '
        f'when vehicles know their place (epoch {KNOWN}) or at the start, of which the first '
        f'{SETTLED} epochs do not count; "told" is that of vehicles that know from the start who '
        'lies. Each vehicle has to name each liar by itself; "never" '
        f'counts those who told it ten lies and more. {lies}.', [rows], goals)

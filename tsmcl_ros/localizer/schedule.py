"""Which messages are taken in, what the time is, and which epoch is next."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from tsmcl_ros.localizer.settings import LocalizerConfig
from tsmcl_ros.model.timeline import Again, Held, Timeline
from tsmcl_ros.types import Array, Estimate, MessageError, Observation

# Who is not told of any time for this long [s] cannot say where its vehicles have gone.
LONGEST_LEAP = 3600.0
# Stamps that are further apart [s], or than time_jump, do not tell the same time.
_SPAN = 10.0
# Nobody is this far ahead [s] of a fleet that speaks every second or so; others are asked first.
_AHEAD = 2.0


class Schedule:
    """
    Gathers the messages of V vehicles into epochs.

    Parameters
    ----------
    config : LocalizerConfig
        Read at every use, as it may change.
    vehicles : int
        V.
    restart : callable
        Starts everything anew, this included, as time has jumped.

    Attributes
    ----------
    now : float
        Latest time that a message or `clock` has told [s], -inf before any has.
    passed : (V,) float
        Stamp of each vehicle's last beacons [s].

    """

    def __init__(self, config: LocalizerConfig, vehicles: int, restart: Callable[[], None]):
        self._config, self._vehicles, self._restart = config, vehicles, restart
        self._refused: list[tuple[int, MessageError]] = []
        self._timeline = Timeline(vehicles, self._span)
        self.reset()

    def reset(self) -> None:
        """Forget all messages, but for those that are to be reported."""
        self.now = -np.inf
        self.passed = np.full(self._vehicles, -np.inf)
        self._lag = 0.0
        self._pending: dict[float, dict[int, Observation]] = {}
        given_up = self._timeline.given_up
        self._timeline = Timeline(self._vehicles, self._span)
        self._timeline.given_up = given_up

    def adjust(self) -> None:
        """Go by what the configuration has become."""
        self._timeline.span = self._span

    @property
    def waiting(self) -> int:
        """How many epochs wait."""
        return len(self._pending)

    def admit(self, what: str, vehicle: int, stamp: float, latest: float, again: Again) -> bool:
        """
        Tell whether a message is to be taken in now, as every one with a stamp must have asked.

        Where time has jumped, for most vehicles that say anything, everything starts anew.

        Parameters
        ----------
        what : str
            Names the messages in an error.
        vehicle : int
            Whose it is.
        stamp, latest : float
            Of the message, and of the last one on its topic, -inf if there was none [s].
        again : callable
            Hands it over again, and so asks again.

        Returns
        -------
        bool
            False if it was held back until it is clear what the time is, or handed over again.

        Raises
        ------
        MessageError
            If it comes too late, or tells another time than most vehicles.

        """
        if stamp == 0 and self.now > LONGEST_LEAP:
            raise MessageError(
                f'{what}: stamp 0 is not allowed, as the time is {self.now:.6f} s: who sends it '
                'leaves it unset')
        late = stamp < self.now - self._config.time_jump
        back = stamp < latest - self._config.time_jump
        if not back and stamp <= latest:
            raise MessageError(
                f'{what}: stamp {stamp:.6f} s is not allowed, must be after the last one, '
                f'{latest:.6f} s')
        ahead = -np.inf < self.now < stamp - (_AHEAD if self._vehicles > 1 else self._span)
        if not (late or ahead):
            self._timeline.accept(vehicle, stamp)
            return True
        if self._timeline.wins(vehicle, stamp, self.now, leaps=back or ahead):
            self._follow(stamp)
            again()
        elif late and not back:
            raise MessageError(
                f'{what}: stamp {stamp:.6f} s is not allowed, must be at most '
                f'{self._config.time_jump:g} s before the newest of all messages, '
                f'{self.now:.6f} s')
        elif not self._timeline.hold(Held(what, vehicle, stamp, again)):
            raise self._stray(what, stamp)
        return False

    def refused(self) -> list[tuple[int, MessageError]]:
        """Return, once, which vehicles' messages were refused after they had been held back."""
        refused, self._refused = self._refused, []
        refused += [(held.vehicle, self._stray(held.what, held.stamp))
                    for held in self._timeline.given_up]
        self._timeline.given_up = []
        return refused

    def note(self, stamp: float) -> None:
        """Take note of the stamp of a message that is in time [s]."""
        self.now = max(self.now, stamp)

    def refuse_late(self, stamp: float, last: Estimate) -> None:
        """
        Hold that the stamp of beacons [s] is after the last epoch.

        Raises
        ------
        MessageError
            If it is not; predictions wait longer then, if that epoch was one.

        """
        if stamp > last.stamp:
            return
        if not last.heard.any():
            self._lag = max(self._lag, self.now - stamp)
        raise MessageError(
            f'beacons: stamp {stamp:.6f} s is not allowed, must be after the last epoch, '
            f'{last.stamp:.6f} s')

    def add(self, vehicle: int, observation: Observation) -> None:
        """Keep what a vehicle heard (V = 1) until its epoch is complete."""
        self.passed[vehicle] = observation.stamp
        self.note(observation.stamp)
        self._pending.setdefault(observation.stamp, {})[vehicle] = observation

    def clock(self, stamp: float) -> None:
        """Let time pass [s] without a message; a jump starts anew."""
        if stamp < self.now - self._config.time_jump or self._is_far_ahead(stamp):
            self._restart()
        self.now = max(self.now, stamp)

    def end(self) -> None:
        """Let the epochs that wait be complete; not what is beyond, as an outage is no news."""
        if self._pending:
            self.now = max(self.now, max(self._pending) + self._config.max_wait)

    def due(self, last: float | None, odometry: Array, begun: bool) -> float | None:
        """
        Return the stamp [s] of the next epoch, or prediction in an outage, if it is complete.

        Parameters
        ----------
        last : float or None
            Stamp of the last epoch [s].
        odometry : (V,) float
            Stamps of the last odometry [s], -inf where there was none.
        begun : bool
            Whether it is known who has odometry.

        """
        stamp = self._next_stamp(last)
        return stamp if stamp is not None and self._is_complete(stamp, odometry, begun) else None

    def take(self, stamp: float) -> Observation:
        """Return what the vehicles heard in an epoch, which is over."""
        heard = self._pending.pop(stamp, {})
        if len(heard) < self._vehicles:
            nothing = Observation.empty(1, 0, self._config.dimension, stamp)
            heard = dict.fromkeys(range(self._vehicles), nothing) | heard
        return Observation.stack([heard[vehicle] for vehicle in range(self._vehicles)], stamp)

    def _next_stamp(self, last: float | None) -> float | None:
        """Return the stamp of the next epoch, or of the next prediction in an outage."""
        pending = min(self._pending, default=None)
        if last is None or self._config.outage_period == 0:
            return pending
        outage = last + self._config.outage_period
        return outage if pending is None or outage < pending else pending

    def _is_complete(self, stamp: float, odometry: Array, begun: bool) -> bool:
        """Tell whether all that belongs to an epoch is there, or has been waited for."""
        wait = self._config.max_wait + (0.0 if stamp in self._pending else self._lag)
        if self.now >= stamp + wait:
            return True
        if (self.passed < stamp).any():
            return False
        return bool((odometry[(odometry > -np.inf) | (not begun)] >= stamp).all())

    @property
    def _span(self) -> float:
        """How far apart stamps may be that tell the same time [s]."""
        return max(self._config.time_jump, _SPAN)

    def _stray(self, what: str, stamp: float) -> MessageError:
        return MessageError(
            f'{what}: stamp {stamp:.6f} s is not allowed, must be within {self._span:g} s of what '
            f'most vehicles tell, {self.now:.6f} s')

    def _follow(self, stamp: float) -> None:
        """Take up the time that most vehicles tell, and what was held back of them."""
        begin, held = self._timeline.follow(stamp)
        if begin < self.now or self._is_far_ahead(begin):
            self._restart()
        else:
            self.now = begin
        for one in held:
            try:
                one.again()
            except MessageError as error:
                self._refused.append((one.vehicle, error))

    def _is_far_ahead(self, stamp: float) -> bool:
        """Tell whether a stamp is so far ahead that nobody can say what has happened since."""
        return -np.inf < self.now < stamp - LONGEST_LEAP

"""
The file that a localizer's last poses are kept in, for the one that is started after it.

With them goes what it has learnt of ranges and rssi, as long as the parameters that it began from
stay.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
import json
import math
from pathlib import Path
import time
from typing import Any, TypeVar

import numpy as np
from tsmcl_ros.endpoint import OutputConfig
from tsmcl_ros.localizer import Localizer
from tsmcl_ros.model.learnt import Learnt, LearntRanges, LearntRssi
from tsmcl_ros.model.resume import Last
from tsmcl_ros.types import Array

_LARGEST = 2**26  # bytes

Told = TypeVar('Told', LearntRanges, LearntRssi)


class Memory:
    """
    Keeps the last poses of a localizer's vehicles on disk, and recalls those of the one before.

    Whatever is wrong with the file is logged once, and the localizer starts from anywhere.

    Parameters
    ----------
    localizer : Localizer
    names : sequence of str
        Of its vehicles.
    output : OutputConfig
        Which file, how often, and which frame.
    complain
        Takes a line.

    """

    def __init__(self, localizer: Localizer, names: Sequence[str], output: OutputConfig,
                 complain: Callable[[str], Any]) -> None:
        self._localizer = localizer
        self._names = list(names)
        self._path = Path(output.resume_from)
        self._output = output
        self._complain = complain
        self._is_broken = False
        self._saved = -math.inf

    def recall(self) -> int:
        """Have the localizer start where the one before ended; return how many vehicles it has."""
        try:
            with self._path.open('rb') as file:
                found, learnt = self._parse(file.read(_LARGEST))
        except FileNotFoundError:
            return 0
        except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
            reason = ' '.join(str(error).split()) or type(error).__name__
            self._complain(f'resume_from: {self._path} is not read{self._kept()}, vehicles start '
                           f'from anywhere: {type(error).__name__}: {reason}')
            return 0
        self._localizer.resume(found, learnt)
        return len(found)

    def save(self, at_once: bool = False) -> None:
        """Write the last poses, if it is time to; whenever it is cut short, a whole file stays."""
        now = time.monotonic()
        if not at_once and now - self._saved < 1 / self._output.save_pose_rate:
            return
        self._saved = now
        poses = {self._names[last.vehicle]: {
            'stamp': last.stamp, 'mean': last.mean.tolist(),
            'covariance': last.covariance.tolist(), 'rotation': last.rotation,
            'rotation_variance': last.rotation_variance, 'odometry': last.odometry.tolist(),
            'speed': last.speed} for last in self._localizer.last_known()}
        if not poses:
            return
        part = self._path.with_name(f'{self._path.name}.part')
        try:
            part.write_text(json.dumps({
                'frame_id': self._output.global_frame_id, 'poses': poses, **self._learnt()}))
            part.replace(self._path)
            self._is_broken = False
        except OSError as error:
            if not self._is_broken:
                self._complain(f'resume_from: {self._path} cannot be written: {error.strerror}')
            self._is_broken = True

    def _kept(self) -> str:
        """Put what is no file of poses out of the way of those to come; return where it is."""
        kept = self._path.with_name(f'{self._path.name}.unread')
        try:
            self._path.replace(kept)
        except OSError:
            return ''
        return f' but kept as {kept.name}'

    def _learnt(self) -> dict[str, Any]:
        """Return what is to be kept of ranges and rssi, as far as they have told anything."""
        return {
            name: {'configured': self._configured(name), **{
                field: np.asarray(value).tolist() for field, value in told._asdict().items()}}
            for name, told in self._localizer.learnt._asdict().items() if told is not None}

    def _configured(self, name: str) -> list[float | str]:
        """Return what is configured: what was learnt from other values is of no use."""
        radio = self._localizer.channel.radio
        if name == 'ranges':
            return [radio.range_scale, radio.range_bias]
        return [radio.rssi_at_reference, radio.reference_distance, radio.path_loss_exponent,
                radio.sigma_db, *radio.anchor_path_loss]

    def _told(self, content: dict[str, Any], name: str, read: Callable[[Any], Told]
              ) -> Told | None:
        """Return what is kept of ranges or rssi, None where it is not or is of no use."""
        told = content.get(name)
        if told is None or told['configured'] != self._configured(name):
            return None
        return read(told)

    def _parse(self, data: bytes) -> tuple[list[Last], Learnt]:
        content = json.loads(data)
        if content['frame_id'] != self._output.global_frame_id:
            raise ValueError(f'frame_id {content["frame_id"]!r} is not allowed, must be '
                             f'{self._output.global_frame_id!r}')
        dimension = self._localizer.config.dimension
        learnt = Learnt(self._told(content, 'ranges', _ranges),
                        self._told(content, 'rssi', _rssi))
        return [
            Last(self._names.index(name), float(pose['stamp']),
                 _array(pose['mean'], 'mean', (dimension,)),
                 _covariance(pose['covariance'], dimension), float(pose['rotation']),
                 float(pose['rotation_variance']),
                 _array(pose['odometry'], 'odometry', (4,), finite=False), float(pose['speed']))
            for name, pose in content['poses'].items() if name in self._names], learnt


def _array(value: Any, name: str, shape: tuple[int, ...], finite: bool = True) -> Array:
    found = np.array(value, float)
    if found.shape != shape or (finite and not np.isfinite(found).all()):
        raise ValueError(f'{name} {value} is not allowed, must have the shape {shape}')
    return found


def _covariance(value: Any, dimension: int) -> Array:
    found = _array(value, 'covariance', (dimension, dimension))
    if not np.allclose(found, found.T) or np.linalg.eigvalsh(found)[0] < -1e-9 * found.trace():
        raise ValueError(f'covariance {value} is not allowed, must be positive semidefinite')
    return found


def _ranges(value: dict[str, Any]) -> LearntRanges:
    found = LearntRanges(
        _array(value['mean'], 'mean', (2,)), _covariance(value['covariance'], 2))
    if not found.is_sound:
        raise ValueError(f'ranges {value} are not allowed, must have a scale above 0')
    return found


def _rssi(value: dict[str, Any]) -> LearntRssi:
    found = LearntRssi(
        _array(value['mean'], 'mean', (2,)), _covariance(value['covariance'], 2),
        float(value['sigma']), float(value['samples']))
    if not found.is_sound:
        raise ValueError(f'rssi {value} are not allowed, must be what rssi can tell')
    return found

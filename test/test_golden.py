"""The same bag, seed and package give the same poses, to the last bit."""

from __future__ import annotations

import importlib.util
import json
import os
from pathlib import Path
import subprocess
import sys

import numpy as np
import pytest
from tsmcl_ros.methods import METHODS

ROOT = Path(__file__).resolve().parents[1]
TOOL = ROOT / 'tools' / 'golden.py'
THREADS = ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS')


@pytest.fixture(scope='module')
def tool():
    spec = importlib.util.spec_from_file_location('golden', TOOL)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope='module')
def golden(tool):
    return json.loads(tool.GOLDEN.read_text())


@pytest.mark.parametrize('method', METHODS)
def test_poses_are_as_they_were(method, tool, golden):
    """Where numpy rounds otherwise, they may differ by what twenty epochs make of a last bit."""
    expected, found = golden['poses'][method], tool.poses(method)
    hint = 'if they are meant to change, run python tools/golden.py'
    np.testing.assert_allclose(found['position'], expected['position'], atol=1e-3, err_msg=hint)
    if golden['rounding'] == tool.rounding():
        assert found['sha256'] == expected['sha256'], hint


def show(cores, threads, hash_seed):
    """Return what a process makes of the bag that has so many cores and threads."""
    mine = sorted(os.sched_getaffinity(0))
    environment = os.environ | dict.fromkeys(THREADS, str(threads)) | {
        'PYTHONHASHSEED': str(hash_seed), 'PYTHONPATH': os.pathsep.join(sys.path)}
    return subprocess.run(
        [sys.executable, TOOL, '--show', 'ts_mcl', 'r_mcl', 'ekf'], env=environment, check=True,
        capture_output=True, text=True,
        preexec_fn=lambda: os.sched_setaffinity(0, mine[:cores])).stdout


def test_neither_cores_nor_threads_nor_the_order_of_sets_show_in_a_pose():
    assert show(cores=1, threads=1, hash_seed=1) == show(cores=2, threads=2, hash_seed=2)

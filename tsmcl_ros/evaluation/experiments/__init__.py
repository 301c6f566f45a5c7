"""The claims of the papers as experiments, by the names that users give."""

from typing import Any

from tsmcl_ros.evaluation.experiments.adaptive_period import ADAPTIVE
from tsmcl_ros.evaluation.experiments.beyond import Beyond
from tsmcl_ros.evaluation.experiments.cooperation import CoopSamples, CoopTime
from tsmcl_ros.evaluation.experiments.grey import Grey
from tsmcl_ros.evaluation.experiments.period_factor import PeriodFactor
from tsmcl_ros.evaluation.experiments.r_mcl import (
    RMclAnchorDensity,
    RMclNodeDensity,
    RMclRssiError,
    RMclTime,
)
from tsmcl_ros.evaluation.experiments.ts_mcl_convergence import TsMclConvergence
from tsmcl_ros.evaluation.experiments.ts_mcl_samples import TsMclRadius, TsMclSamples, TsMclTime
from tsmcl_ros.evaluation.monte_carlo import Experiment

_SMALL: dict[str, Any] = {'runs': 2, 'vehicles': 5, 'epochs': 8, 'settled': 3,
                          'first_particles': 100, 'grid_cell': 0.1}

# Each at full size, and at one that takes seconds.
EXPERIMENTS: dict[str, tuple[Experiment, Experiment]] = {
    'ts_mcl_convergence': (
        TsMclConvergence(),
        TsMclConvergence(
            runs=2, vehicles=6, epochs=8, bootstrap=((50, 500), (200, 2000)),
            grid_cell=100.0, exact_vehicles=2, lens_vehicles=10, lens_epochs=4)),
    'ts_mcl_samples': (
        TsMclSamples(),
        TsMclSamples(**_SMALL, particles=(2, 4, 8, 12))),
    'ts_mcl_time': (
        TsMclTime(),
        TsMclTime(**_SMALL, iterations=(1, 10), particles=20, fewer=4)),
    'ts_mcl_radius': (
        TsMclRadius(),
        TsMclRadius(**_SMALL, ranges=(500.0, 1000.0), particles=(10,))),
    'grey_straight': (Grey(turn=0.0), Grey(turn=0.0, runs=2, vehicles=50)),
    'grey_maneuver': (Grey(turn=35.0), Grey(turn=35.0, runs=2, vehicles=50)),
    'coop_samples': (
        CoopSamples(), CoopSamples(runs=1, targets=20, samples=(20, 50), rounds=2, grid_cell=5.0)),
    'coop_time': (
        CoopTime(), CoopTime(runs=1, targets=20, samples=(20, 50), rounds=2, grid_cell=5.0)),
    'period_factor': (PeriodFactor(), PeriodFactor(residuals=101)),
    **ADAPTIVE,
    **{name: (kind(), kind(runs=1, vehicles=8, epochs=5, grid_cell=10.0, radius=100.0))
       for name, kind in {
           'r_mcl_time': RMclTime,
           'r_mcl_anchor_density': RMclAnchorDensity,
           'r_mcl_node_density': RMclNodeDensity,
           'r_mcl_rssi_error': RMclRssiError,
       }.items()},
    'beyond': (
        Beyond(),
        Beyond(runs=1, vehicles=6, epochs=8, particles=(10, 20), most=100, grid_cell=100.0,
               yardstick_vehicles=2)),
}

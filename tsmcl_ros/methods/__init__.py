"""The localization methods by the names that users give."""

from typing import Any

from tsmcl_ros.methods.cooperative import Cooperative
from tsmcl_ros.methods.ekf import Ekf
from tsmcl_ros.methods.grey_ekf import GreyEkf
from tsmcl_ros.methods.grid import Grid
from tsmcl_ros.methods.mcb import Mcb
from tsmcl_ros.methods.mcl import Mcl
from tsmcl_ros.methods.nbp import Nbp
from tsmcl_ros.methods.r_mcl import RMcl
from tsmcl_ros.methods.ts_mcl import TsMcl

# Each is an Estimator with a Config of its own, which is what keeps a common type from them.
METHODS: dict[str, Any] = {
    'ts_mcl': TsMcl,
    'mcl': Mcl,
    'mcb': Mcb,
    'r_mcl': RMcl,
    'grid': Grid,
    'ekf': Ekf,
    'cooperative': Cooperative,
    'nbp': Nbp,
    'grey_ekf': GreyEkf,
}

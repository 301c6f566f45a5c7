"""The localization methods by the names that users give."""

from tsmcl_ros.methods.grid import Grid
from tsmcl_ros.methods.mcl import Mcl
from tsmcl_ros.methods.ts_mcl import TsMcl

METHODS = {'ts_mcl': TsMcl, 'mcl': Mcl, 'grid': Grid}

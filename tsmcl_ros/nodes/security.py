"""Nodes that run only where DDS security keeps strangers out."""

from __future__ import annotations

from dataclasses import dataclass
import os

from tsmcl_ros.config import Config, param
from tsmcl_ros.types import ConfigError


@dataclass(frozen=True)
class SecurityConfig(Config):
    """Whether a node insists on DDS security."""

    require_security: bool = param(
        False, 'do not start unless DDS security is enforced, by ROS_SECURITY_ENABLE, '
        'ROS_SECURITY_STRATEGY and ROS_SECURITY_KEYSTORE')

    def check(self) -> None:
        """
        Hold that security is on where it is required.

        What the environment asks for is what a node has: where it is to be enforced, ROS creates
        no node without it, be it for want of keys or of a DDS that knows how.
        """
        if not self.require_security:
            return
        # Spelt as rcl's security.c reads them; with any other strategy it goes on without keys.
        for name, wanted in (('ROS_SECURITY_ENABLE', 'true'), ('ROS_SECURITY_STRATEGY', 'Enforce'),
                             ('ROS_SECURITY_KEYSTORE', '')):
            value = os.environ.get(name, '')
            if value != wanted if wanted else not value:
                raise ConfigError(
                    f'require_security: DDS security is off, as {name} is {value!r}, must be '
                    f'{wanted or "the folder of a keystore"}')

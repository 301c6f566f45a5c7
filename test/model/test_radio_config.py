"""What radios are told to be like."""

from __future__ import annotations

import pytest
from tsmcl_ros.model.radio_config import RadioConfig
from tsmcl_ros.types import ConfigError


@pytest.mark.parametrize('row', ['', '7', '7 -50 2', '7 -50 2 4 1', 'seven -50 2 4', '7 -50 0 4',
                                 '7 -50 2 0', '7 nan 2 4', '-7 -50 2 4'])
def test_a_path_loss_that_is_none_is_refused(row: str) -> None:
    with pytest.raises(ConfigError, match=f'anchor_path_loss: .{row}. is not allowed'):
        RadioConfig(anchor_path_loss=(row,))


def test_two_path_losses_of_one_anchor_are_refused() -> None:
    with pytest.raises(ConfigError, match="'7 -60 2 4' is not allowed, .* once"):
        RadioConfig(anchor_path_loss=('7 -50 2 4', '7 -60 2 4'))

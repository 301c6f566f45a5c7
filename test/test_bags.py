"""The bags that come with the package, as `demo` recorded them over DDS."""

from pathlib import Path

import pytest
from tsmcl_ros.bag import Reader
from tsmcl_ros.config import load_yaml
from tsmcl_ros.scripts.localize_bag import localize_bag

ROOT = Path(__file__).parents[1]
BAGS = ('sumo', 'waypoint')


def poses(bag: Path) -> dict[str, list[bytes]]:
    with Reader(bag) as reader:
        found: dict[str, list[bytes]] = {
            topic: [] for topic in reader.topics if topic.endswith('/pose')}
        for message in reader.messages(found):
            found[message.topic].append(message.data)
    return found


@pytest.mark.parametrize('name', BAGS)
def test_poses_published_live_come_out_of_the_bag_again_bit_for_bit(
        name: str, tmp_path: Path) -> None:
    settings = load_yaml(ROOT / 'config' / 'range_free.yaml') | {'seed': 1}
    localize_bag(str(ROOT / 'bags' / name), str(tmp_path / 'again'), settings)
    assert poses(tmp_path / 'again') == poses(ROOT / 'bags' / name)


def test_the_bags_are_small() -> None:
    assert sum(path.stat().st_size for path in (ROOT / 'bags').rglob('*')) < 2_000_000


def test_the_bags_readme_tells_of_each() -> None:
    text = (ROOT / 'bags' / 'README.md').read_text()
    assert all(f'`{name}`' in text for name in BAGS)
    assert {path.name for path in (ROOT / 'bags').iterdir() if path.is_dir()} == set(BAGS)

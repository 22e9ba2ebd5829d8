"""What config/ has for RViz, Foxglove and robot_localization fits what the nodes publish."""

import json
from pathlib import Path
import re

from mv_slapse.nodes.settings import FrameSettings
import yaml

ROOT = Path(__file__).resolve().parents[1]
LAYOUT = json.loads((ROOT / 'config' / 'foxglove.json').read_text())
TOPICS = {f'/{name.lstrip("/")}' for row in re.findall(
    r'^\| (`[^|]*`) \|.*\|$', (ROOT / 'docs' / 'topics.md').read_text(), re.M)
    for name in re.findall(r'`([^`]+)`', row)}


def panels(layout) -> set[str]:
    if isinstance(layout, str):
        return {layout}
    assert layout['direction'] in ('row', 'column')
    return panels(layout['first']) | panels(layout['second'])


def values(content, keys):
    """Yield what stands under some keys, however deep."""
    if isinstance(content, dict):
        for key, value in content.items():
            if key in keys and isinstance(value, str):
                yield value
            yield from values(value, keys)
    elif isinstance(content, list):
        for item in content:
            yield from values(item, keys)


def test_every_panel_of_the_layout_is_set_up_and_shown():
    assert panels(LAYOUT['layout']) == set(LAYOUT['configById'])
    kinds = {name.split('!')[0] for name in LAYOUT['configById']}
    assert {'3D', 'Image', 'DiagnosticSummary'} <= kinds


def test_the_topics_of_the_layout_exist():
    shown = {topic for panel in LAYOUT['configById'].values() for topic in panel.get('topics', {})}
    shown |= set(values(LAYOUT, ('imageTopic', 'topicToRender', 'poseEstimateTopic')))
    shown |= {path.split('.')[0] for path in values(LAYOUT, ('value',))}
    assert {'/planes/map_markers', '/obstacles/markers', '/image_overlay'} <= shown
    assert shown <= TOPICS


def test_the_topics_of_rviz_exist():
    content = yaml.safe_load((ROOT / 'config' / 'mv_slapse.rviz').read_text())
    displays = content['Visualization Manager']['Displays']
    shown = {f'/{item["Topic"]["Value"].lstrip("/")}' for item in displays if 'Topic' in item}
    assert {'/planes/map_markers', '/obstacles/markers', '/image_overlay'} <= shown <= TOPICS


def test_robot_localization_is_told_of_our_topics_and_frames():
    settings = yaml.safe_load((ROOT / 'config' / 'robot_localization.yaml').read_text())
    given, frames = settings['/**']['ros__parameters'], FrameSettings()
    assert (given['odom_frame'], given['base_link_frame'], given['world_frame']) == (
        frames.odom_frame, frames.base_frame, frames.odom_frame)
    assert {f'/{given["odom0"]}', f'/{given["odom1"]}'} <= TOPICS
    configs = {name: row for name, row in given.items() if name.endswith('_config')}
    assert set(configs) == {'odom0_config', 'odom1_config', 'imu0_config'}
    for row in configs.values():
        assert len(row) == 15
        assert all(isinstance(value, bool) for value in row)
    # pose and twist of one filter are not independent: only one of them may be fused
    assert not any(given['odom0_config'][6:])

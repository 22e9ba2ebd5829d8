"""What config/ has for RViz and Foxglove names topics that there are."""

import json
from pathlib import Path
import re

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

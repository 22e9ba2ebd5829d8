"""The access control policy of the nodes for SROS2, written from the table of topics."""

import argparse
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
import re
from xml.etree import ElementTree  # to write XML, none is read  # nosec B405

FOUR = ('decoder', 'plane_extraction', 'slam', 'obstacle_tracker')
ALL = (*FOUR, 'all_in_one')
#: of every node of ROS 2
PUBLISHED = ('/parameter_events', '/rosout')
SUBSCRIBED = ('/clock', '/parameter_events')
SERVICES = tuple(f'~/{name}' for name in (
    'describe_parameters', 'get_parameter_types', 'get_parameters', 'get_type_description',
    'list_parameters', 'set_parameters', 'set_parameters_atomically'))
HEAD = '<!-- Written by `make config` from docs/topics.md; do not edit. -->\n'


@dataclass
class Rights:
    """What a node may publish, subscribe to and answer."""

    publish: set[str] = field(default_factory=lambda: set(PUBLISHED))
    subscribe: set[str] = field(default_factory=lambda: set(SUBSCRIBED))
    reply: set[str] = field(default_factory=lambda: set(SERVICES))


def rights(page: str) -> dict[str, Rights]:
    """Return the rights of each node that a page with the table of topics gives."""
    found = {name: Rights() for name in ALL}
    for names, out, into in _rows(page):
        for topic in names:
            for name in out:
                found[name].publish.add(topic)
            for name in into:
                found[name].subscribe.add(topic)
            # in one process what the four tell one another stays inside, but may be read
            if out:
                found['all_in_one'].publish.add(topic)
            else:
                found['all_in_one'].subscribe.add(topic)
    for names, services in _services(page):
        for name in names:
            found[name].reply |= set(services)
    return found


def policy(page: str) -> str:
    """Return the policy as XML."""
    root = ElementTree.Element('policy', version='0.2.0')
    enclaves = ElementTree.SubElement(root, 'enclaves')
    for name, of in rights(page).items():
        enclave = ElementTree.SubElement(enclaves, 'enclave', path=f'/mv_slapse/{name}')
        profiles = ElementTree.SubElement(enclave, 'profiles')
        profile = ElementTree.SubElement(profiles, 'profile', ns='/', node=name)
        _allow(profile, 'topic', 'publish', of.publish)
        _allow(profile, 'topic', 'subscribe', of.subscribe)
        _allow(profile, 'service', 'reply', of.reply)
    ElementTree.indent(root)
    return HEAD + ElementTree.tostring(root, encoding='unicode') + '\n'


def _allow(profile: ElementTree.Element, kind: str, verb: str, names: Iterable[str]):
    group = ElementTree.SubElement(profile, kind + 's', {verb: 'ALLOW'})
    for name in sorted(names):
        ElementTree.SubElement(group, kind).text = name


def _rows(page: str) -> Iterable[tuple[list[str], set[str], set[str]]]:
    """Yield topics, who publishes them, and who reads them, of each row of the table."""
    for line in page.splitlines():
        cells = [cell.strip() for cell in line.strip('|').split('|')]
        if not line.startswith('| `') or len(cells) < 3 or not re.search('[→↔]', cells[2]):
            continue
        out, arrow, into = re.split('([→↔])', cells[2], maxsplit=1)
        both = arrow == '↔'
        left, right = _nodes(out), _nodes(into)
        yield (re.findall(r'`([^`]+)`', cells[0]), left | (right if both else set()),
               right | (left if both else set()))


def _nodes(cell: str) -> set[str]:
    return set(ALL) if cell.strip() == 'all' else set(re.findall(r'`(\w+)`', cell)) & set(ALL)


def _services(page: str) -> Iterable[tuple[set[str], list[str]]]:
    """Yield nodes and the services that a sentence of the page gives them."""
    said = re.search(r'^Services: (.*?)\.\s', page, re.M | re.S)
    for part in ' '.join(said[1].split()).split(';') if said else ():
        services, _, names = part.partition(' of ')
        nodes = set(ALL) if 'every node' in names else _nodes(names)
        yield nodes, re.findall(r'`(~/\w+)`', services)


def main() -> int:
    """Write the policy that a page of topics gives into a file."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument('page', type=Path)
    parser.add_argument('file', type=Path)
    args = parser.parse_args()
    args.file.write_text(policy(args.page.read_text(encoding='utf-8')), encoding='utf-8')
    print(args.file)
    return 0


if __name__ == '__main__':
    raise SystemExit(main())

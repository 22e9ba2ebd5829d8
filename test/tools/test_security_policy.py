from pathlib import Path
from xml.etree import ElementTree

from mv_slapse.tools import security_policy
import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / 'docs' / 'topics.md').read_text(encoding='utf-8')
POLICY = (ROOT / 'config' / 'sros2_policy.xml').read_text(encoding='utf-8')
VERBS = {'publish', 'subscribe', 'reply', 'request', 'call', 'execute'}
#: what policy.xsd of sros2 allows: attributes that must be and may be, and children
SCHEMA = {
    'policy': ({'version'}, set(), {'enclaves'}), 'enclaves': (set(), set(), {'enclave'}),
    'enclave': ({'path'}, set(), {'profiles'}), 'profiles': (set(), {'type'}, {'profile'}),
    'profile': ({'ns', 'node'}, set(), {'topics', 'services', 'actions'}),
    'topics': (set(), {'publish', 'subscribe'}, {'topic'}),
    'services': (set(), {'reply', 'request'}, {'service'}),
    'actions': (set(), {'call', 'execute'}, {'action'}),
    'topic': (set(), set(), set()), 'service': (set(), set(), set()),
    'action': (set(), set(), set())}


def faults(element) -> list[str]:
    """Return what the schema of policies does not allow."""
    needed, allowed, children = SCHEMA[element.tag]
    found = [f'{element.tag}: attribute {name}' for name in
             (needed - set(element.attrib)) | (set(element.attrib) - needed - allowed)]
    found += [f'{element.tag}: {name}={value}' for name, value in element.attrib.items()
              if name in VERBS and value not in ('ALLOW', 'DENY')]
    if children and not len(element):
        found.append(f'{element.tag} is empty')
    if not children and not (element.text or '').strip():
        found.append(f'{element.tag} has no name')
    for child in element:
        found += faults(child) if child.tag in children else [f'{child.tag} in {element.tag}']
    return found


def test_the_policy_is_the_one_that_the_table_of_topics_gives():
    assert security_policy.policy(PAGE) == POLICY, 'run make config'


def test_it_obeys_the_schema_of_policies():
    root = ElementTree.fromstring(POLICY)
    assert faults(root) == []
    assert root.get('version') == '0.2.0'
    assert [enclave.get('path') for enclave in root.iter('enclave')] == [
        f'/mv_slapse/{name}' for name in security_policy.ALL]


@pytest.mark.parametrize(('old', 'new'), [
    ('publish="ALLOW"', 'publish="YES"'), ('<enclaves>', '<contexts>'), (' node="slam"', ''),
    ('<topic>odometry</topic>', '<topic />')])
def test_the_check_of_the_schema_bites(old, new):
    broken = POLICY.replace(old, new).replace('</enclaves>', f'</{new[1:-1]}>' if
                                              'enclaves' in old else '</enclaves>')
    assert faults(ElementTree.fromstring(broken))


def test_a_node_may_do_what_the_table_says_and_no_more():
    found = security_policy.rights(PAGE)
    assert 'odometry' in found['slam'].publish & found['obstacle_tracker'].subscribe
    assert 'odometry' not in found['decoder'].subscribe | found['decoder'].publish
    assert 'planes/handover' in found['slam'].publish & found['slam'].subscribe
    assert {'video', 'initialpose'} <= found['all_in_one'].subscribe
    assert not {'odometry', 'correspondences'} & found['all_in_one'].subscribe
    assert {'~/reset', '~/load_map'} <= found['slam'].reply
    assert '~/load_map' not in found['decoder'].reply

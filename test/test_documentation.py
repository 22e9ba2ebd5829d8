"""What README and docs name is there: files, functions, commands, settings, topics, pictures."""

import ast
from dataclasses import fields
from pathlib import Path
import re

from mv_slapse.config import Settings
from mv_slapse.tools.main import parser
import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / 'README.md', ROOT / 'CONTRIBUTING.md', *sorted((ROOT / 'docs').glob('*.md'))]
COMMANDS, PAPERS, REFUSALS, TOPICS = (
    (ROOT / 'docs' / name).read_text(encoding='utf-8') for name in (
        'command_line.md', 'papers.md', 'troubleshooting.md', 'topics.md'))
FIELD = '\0'
SOURCES = '\n'.join(path.read_text(encoding='utf-8')
                    for path in (ROOT / 'mv_slapse').rglob('*.py'))


def commands() -> dict[str, set[str]]:
    """Return the options of each command of the command line."""
    [subparsers] = [action for action in parser()._actions if hasattr(action.choices, 'items')]
    return {name: set(command._option_string_actions)
            for name, command in subparsers.choices.items()}


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.name)
def test_every_link_leads_somewhere(page):
    text = page.read_text(encoding='utf-8')
    headings = {re.sub(r'[^a-z0-9 -]', '', line.lower()).strip().replace(' ', '-')
                for line in re.findall(r'^#+ (.*)$', text, re.M)}
    for target in re.findall(r'\]\(([^)]+)\)', text):
        if target.startswith('#'):
            assert target[1:] in headings
        elif '://' not in target:
            assert (page.parent / target).exists(), target


def test_every_function_named_beside_a_file_is_defined_in_it():
    rows = [re.findall(r'`([^`]+)`', cell) for line in PAPERS.splitlines()
            if line.startswith('| ') for cell in line.split('|')[-2].split(';')]
    named = [(names[0], names[1:]) for names in rows if names and names[0].endswith('.py')]
    assert len(named) > 20
    for file, names in named:
        tree = ast.parse((ROOT / 'mv_slapse' / file).read_text(encoding='utf-8'))
        defined = {node.name for node in tree.body if hasattr(node, 'name')}
        assert names, file
        assert set(names) <= defined, file


def test_the_table_of_commands_names_every_command_and_only_options_it_has():
    rows = dict(re.findall(r'^\| `mv_slapse (\w+)(.*)$', COMMANDS, re.M))
    assert set(rows) == set(commands())
    for name, row in rows.items():
        assert set(re.findall(r'(?<![\w-])--?[a-z][a-z-]*', row)) <= commands()[name], name


def test_every_make_target_named_exists():
    targets = set(re.findall(r'^([a-z-]+):', (ROOT / 'Makefile').read_text(), re.M))
    named = {name for page in PAGES
             for name in re.findall(r'(?:`|^)make ([a-z-]+)', page.read_text(), re.M)}
    assert named
    assert named <= targets


def test_every_setting_named_exists():
    known = {f'{part.name}.{item.name}' for part in fields(Settings)
             for item in fields(part.default_factory)}
    sections = '|'.join(part.name for part in fields(Settings))
    named = {name for page in PAGES
             for name in re.findall(rf'`?\b((?:{sections})\.[a-z_]+)\b', page.read_text())}
    assert 'scene.camera_height' in named
    assert {name for name in named if not name.endswith(('.py', '.csv', '.yaml'))} <= known


def test_every_topic_that_a_node_publishes_is_in_the_table():
    published = re.findall(r"create_publisher\(\s*[\w.]+,\s*'([^']+)'", SOURCES)
    rows = re.findall(r'^\| (`[^|]*`) \|.*\|$', TOPICS, re.M)
    listed = {name for row in rows for name in re.findall(r'`([^`]+)`', row)}
    assert {'odometry', '/tf', '/diagnostics'} <= set(published)
    assert {name for name in published if not name.startswith('~')} <= listed


def refusals() -> list[str]:
    cells = re.findall(r'^\| (`[^|]+) \|', REFUSALS, re.M)
    return [quoted for cell in cells for quoted in re.findall('`([^`]+)`', cell)
            if quoted != 'make']


def text_of(node: ast.expr) -> str | None:
    """Return the text that an expression makes, a FIELD for what differs; None of another."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return ''.join(part.value if isinstance(part, ast.Constant) else FIELD
                       for part in node.values)
    return None


def is_logging(function: ast.expr) -> bool:
    """Tell whether a call of this logs a warning or worse."""
    return (isinstance(function, ast.Attribute) and function.attr in ('warning', 'error', 'fatal')
            and 'logger' in ast.unparse(function.value))


@pytest.fixture(scope='module')
def nodes() -> list[ast.AST]:
    """All of the syntax of the package's code."""
    return [node for path in (ROOT / 'mv_slapse').rglob('*.py')
            for node in ast.walk(ast.parse(path.read_text(encoding='utf-8')))]


@pytest.fixture(scope='module')
def messages(nodes) -> str:
    """All texts in the code, those with fields in them as one."""
    texts = filter(None, map(text_of, nodes))
    return '\n'.join([*texts, (ROOT / '.setup' / 'environment.sh').read_text()])


def pattern_of(quoted: str) -> str:
    pieces = re.split(r"…|\bN\b|'omni'|\bhevc\b|\d+x\d+|0\.0", quoted)
    return '.*'.join(re.escape(piece.strip()) for piece in pieces if len(piece.strip()) > 1)


@pytest.mark.parametrize('quoted', refusals())
def test_every_refusal_quoted_is_one_the_code_makes(messages, quoted):
    pattern = pattern_of(quoted)
    assert pattern
    assert re.search(pattern, messages), pattern


def test_every_error_has_an_entry_among_the_refusals(nodes):
    """What errors and warnings of this package say, but those that hand others on."""
    kinds = {'UsageError', 'UnusableInput', 'UnusableOutput', 'InvalidMessage', 'MissingKernels'}
    said = {text_of(node.args[0]) or '' for node in nodes
            if isinstance(node, ast.Call) and node.args
            and (getattr(node.func, 'id', '') in kinds or is_logging(node.func))}
    patterns = [pattern for pattern in map(pattern_of, refusals()) if len(pattern) > 8]
    assert len(said) > 50
    assert [text for text in sorted(said) if len(re.findall('[a-z]', text)) > 8
            and not any(re.search(pattern, text, re.S) for pattern in patterns)] == []


def test_the_picture_is_small():
    assert (ROOT / 'docs' / 'demo.png').stat().st_size < 200_000

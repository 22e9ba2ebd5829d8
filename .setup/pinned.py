"""Check that the libraries of this environment have the versions that were tested."""

from importlib.metadata import distributions
from pathlib import Path
import re
import sys

HERE = Path(__file__).resolve().parent


def main() -> int:
    """Print what differs; return 1 where something does."""
    ros = (Path(sys.prefix) / '.ros').read_text().strip()
    pins = {}
    for name in ('pins.txt', 'pins_apt.txt' if ros == 'apt' else 'pins_wheels.txt'):
        pins |= dict(re.findall(r'^([\w.-]+)==(\S+)', (HERE / name).read_text(), re.M))
    found = {}
    for one in distributions(path=[path for path in sys.path if path.startswith(sys.prefix)]):
        found[re.sub(r'[-_.]+', '-', one.metadata['Name']).lower()] = one.version
    strange = [f'{name} {version} is not {pins[name]}, which was tested'
               for name, version in sorted(found.items()) if pins.get(name, version) != version]
    print('\n'.join(strange), file=sys.stderr, end='\n' if strange else '')
    return bool(strange)


if __name__ == '__main__':
    sys.exit(main())

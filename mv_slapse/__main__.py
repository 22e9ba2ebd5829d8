"""``python -m mv_slapse``: the command line."""

import sys


def main() -> int:
    """Run the command line and return its exit code."""
    # Imported here, so that a missing library is reported rather than traced back.
    try:
        from mv_slapse.tools.main import main as command_line
    except ModuleNotFoundError as error:
        if (error.name or '').startswith('mv_slapse'):
            raise
        sys.stderr.write(f'mv_slapse: the library {error.name} is missing; install it with '
                         '`make setup`, or see `python -m mv_slapse.tools.doctor`\n')
        return 3
    return command_line()


if __name__ == '__main__':
    sys.exit(main())

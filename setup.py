"""Install mv_slapse, and with it its compiled kernels and the messages of ``msg_defs``.

colcon looks for no package inside another one, so what colcon runs (``install`` and
``develop --editable``) also builds the interface package with CMake, into the same prefix. pip
runs other commands: it installs the Python package and the ``mv_slapse`` program alone.

The kernels are a module of their own beside the package, built with CMake, too: a module inside
the package would not be found where colcon or pip only link to the sources.
"""

from glob import glob
import os
from pathlib import Path
import shlex
import subprocess
import sys
import sysconfig
import zlib

from setuptools import Command, Distribution, find_packages, setup
from setuptools.command.build_ext import build_ext
from setuptools.command.develop import develop
from setuptools.command.install import install

NAME = 'mv_slapse'
NODES = ('decoder', 'plane_extraction', 'slam', 'obstacle_tracker', 'all_in_one')
PROGRAM = 'mv_slapse = mv_slapse.__main__:main'
REQUIREMENTS = ['av>=10', 'matplotlib>=3.6', 'mcap>=1', 'numpy>=1.26',
                'opencv-python-headless>=4.6,<5', 'pyyaml>=6', 'rosbags>=0.10', 'scipy>=1.11',
                'tqdm>=4']
HERE = Path(__file__).resolve().parent
BY_COLCON = 'install' in sys.argv or '--editable' in sys.argv
LAUNCHER = """#!/bin/sh
prefix={prefix}
. "$prefix/local_setup.sh"
exec "$prefix/bin/python" -Pc 'import sys
from mv_slapse.nodes.{node} import main
sys.exit(main())' "$@"
"""


def cmake_environment(prefix):
    """Return an environment in which CMake finds ROS and Python its true prefix."""
    env = dict(os.environ)
    # Not resolved: the interpreter of a virtual environment is a link that leads out of it.
    python = Path(sys.executable).parent.parent
    known = env.get('AMENT_PREFIX_PATH', '').split(os.pathsep)
    prefixes = dict.fromkeys([*filter(None, known), str(python), os.path.abspath(prefix)])
    for name in ('AMENT_PREFIX_PATH', 'CMAKE_PREFIX_PATH'):
        rest = filter(None, env.get(name, '').split(os.pathsep))
        env[name] = os.pathsep.join(dict.fromkeys([*rest, *prefixes]))
    env['PATH'] = os.pathsep.join([str(Path(sys.executable).parent), env.get('PATH', '')])
    # colcon moves sys.prefix by a sitecustomize module, which CMake's Python must not see.
    path = env.pop('PYTHONPATH', '').split(os.pathsep)
    env['PYTHONPATH'] = os.pathsep.join(p for p in path if p and 'prefix_override' not in p)
    if not any(Path(p, 'share/rosidl_default_generators').is_dir() for p in prefixes):
        raise SystemExit('mv_slapse: ROS 2 Jazzy is not found, so its messages cannot be built. '
                         'Source /opt/ros/jazzy/setup.sh, or run `make setup` and source '
                         '.venv/setup.sh, then build again.')
    return env


def build_interfaces(source, prefix, build, destdir=None):
    """Build the interface package in ``source`` with CMake and install it into ``prefix``."""
    env = cmake_environment(prefix)
    if destdir:
        env['DESTDIR'] = destdir
    run_cmake(source, prefix, build, env, f'-DPython3_EXECUTABLE={sys.executable}',
              '-DBUILD_TESTING=OFF', '-Wno-dev')


def build_kernels(folder, build):
    """Build the compiled kernels with CMake and install them into a folder of Python modules.

    CMAKE_ARGS of the environment are options for CMake, as other packages take them.
    """
    # CMake keeps what it has found of one Python, so that another one needs another build folder.
    build = Path(build, f'kernels-{zlib.crc32(sys.prefix.encode()):08x}').absolute()
    run_cmake(HERE / 'mv_slapse' / 'kernels', os.path.abspath(folder), build, None,
              f'-DPython_EXECUTABLE={sys.executable}',
              *shlex.split(os.environ.get('CMAKE_ARGS', '')))


def run_cmake(source, prefix, build, env, *options):
    """Configure, build and install; what has not changed is not built again."""
    for command in (
            ['cmake', '-S', source, '-B', build, f'-DCMAKE_INSTALL_PREFIX={prefix}',
             '-DCMAKE_BUILD_TYPE=Release', *options],
            ['cmake', '--build', build, '--parallel', str(os.cpu_count())],
            ['cmake', '--install', build]):
        subprocess.run([str(word) for word in command], env=env, check=True)


class Install(install):
    """``colcon build``: Python files, kernels and messages."""

    def run(self):
        """Install, then build kernels and messages; not into a wheel, which pip asks for."""
        super().run()
        if BY_COLCON:
            build = Path(self.get_finalized_command('build').build_base).absolute()
            build_kernels(self.install_lib, build)
            build_interfaces(HERE / 'msg_defs', self.prefix, build / 'mv_slapse_msgs', self.root)


class Develop(develop):
    """``colcon build --symlink-install``: links, kernels and messages."""

    def run(self):
        """Link, then build kernels and messages; colcon runs this in its build directory."""
        super().run()
        if BY_COLCON and not self.uninstall:
            build_kernels(self.install_dir, '.')
            build_interfaces(HERE / 'msg_defs', sys.prefix, Path('mv_slapse_msgs').absolute())


class BuildKernels(build_ext):
    """The kernels of a wheel; of an editable one, too, which holds nothing else."""

    def run(self):
        """Build them, unless the virtual environment of this clone has them already."""
        if os.environ.get('MV_SLAPSE_KERNELS') != 'installed':
            editable = self.editable_mode or self.inplace
            folder = self.get_finalized_command('install').install_lib if editable else \
                self.build_lib
            build_kernels(folder, 'build')

    def get_outputs(self):
        """Return no files: setuptools would look for extensions that it has built itself."""
        return []


class Compiled(Distribution):
    """Says that a wheel fits one Python and machine only; colcon builds the kernels apart."""

    def has_ext_modules(self):
        """Return whether there is something to compile."""
        return not BY_COLCON


class Kernels(Command):
    """Build the compiled kernels into the interpreter that runs this."""

    description = 'build the compiled kernels with CMake'
    user_options = [('build=', None, 'where to build them')]

    def initialize_options(self):
        """Build beside everything else that setuptools builds."""
        self.build = 'build'

    def finalize_options(self):
        """Nothing to settle."""

    def run(self):
        """Build and install."""
        build_kernels(sysconfig.get_path('platlib'), self.build)


class Interfaces(Command):
    """Build one interface package into a prefix."""

    description = 'build an interface package with CMake'
    user_options = [('source=', None, 'folder of the package'),
                    ('prefix=', None, 'where to install it'),
                    ('build=', None, 'where to build it')]

    def initialize_options(self):
        """Take the virtual environment that runs this as the prefix."""
        self.source, self.prefix, self.build = 'msg_defs', sys.prefix, 'build/mv_slapse_msgs'

    def finalize_options(self):
        """Make the paths independent of CMake's working directory."""
        self.source, self.prefix, self.build = (
            os.path.abspath(path) for path in (self.source, self.prefix, self.build))

    def run(self):
        """Build and install."""
        build_interfaces(self.source, self.prefix, self.build)


class Overlay(Command):
    """Make a virtual environment a ROS prefix that holds this package."""

    description = 'write launchers, share and index entry into the virtual environment'
    user_options = []

    def initialize_options(self):
        """Nothing to choose: the prefix is the environment that runs this."""

    def finalize_options(self):
        """Nothing to settle."""

    def run(self):
        """Write what ``ros2 run`` and ``ros2 launch`` look for; data files stay links."""
        prefix = Path(sys.prefix)
        for node in NODES:
            target = prefix / 'lib' / NAME / node
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_text(LAUNCHER.format(prefix=shlex.quote(str(prefix)), node=node))
            target.chmod(0o755)
        for folder, files in DATA_FILES:
            (prefix / folder).mkdir(parents=True, exist_ok=True)
            for file in files:
                link = prefix / folder / Path(file).name
                link.unlink(missing_ok=True)
                link.symlink_to(HERE / file)


DATA_FILES = [
    ('share/ament_index/resource_index/packages', ['resource/' + NAME]),
    ('share/' + NAME, ['package.xml']),
    ('share/' + NAME + '/launch', sorted(glob('mv_slapse/launch/*.launch.py'))),
    ('share/' + NAME + '/config', sorted(filter(os.path.isfile, glob('config/*')))),
]
# colcon leaves bin to what is no script of a node, pip what CMake makes of the messages.
OTHERS = ([('bin', ['mv_slapse/launch/mv_slapse'])] if BY_COLCON else
          [('share/mv_slapse_msgs/msg', sorted(glob('msg_defs/msg/*.msg')))])
SCRIPTS = [PROGRAM, *(f'{node} = mv_slapse.nodes.{node}:main' for node in NODES if BY_COLCON)]

setup(
    name=NAME,
    version='0.1.0',
    description='Pose, plane map and moving obstacles from the motion vectors of encoded video',
    license='Apache-2.0',
    maintainer='mv_slapse maintainers',
    maintainer_email='mv-slapse@users.noreply.github.com',
    packages=find_packages(include=[NAME, NAME + '.*']),
    data_files=[*DATA_FILES, *OTHERS],
    python_requires='>=3.11',
    # ROS brings the libraries as system packages, under names that pip does not know.
    install_requires=['setuptools'] if BY_COLCON else REQUIREMENTS,
    extras_require={'batch': ['dask>=2024.8', 'distributed>=2024.8'], 'test': ['pytest']},
    entry_points={'console_scripts': SCRIPTS},
    zip_safe=False,
    distclass=Compiled,
    cmdclass={'install': Install, 'develop': Develop, 'build_ext': BuildKernels,
              'interfaces': Interfaces, 'kernels': Kernels, 'overlay': Overlay},
)

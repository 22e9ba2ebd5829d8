"""The part of ``launch`` and ``launch_ros`` that our launch file uses, where ROS' is absent.

``resolve`` evaluates a launch file with arguments and returns what it would start.
"""

from dataclasses import dataclass, field
import os
import runpy
import sys
import tempfile
import types

from ament_index_python.packages import get_package_prefix, get_package_share_directory
import yaml


@dataclass
class Started:
    """A process that the launch file asks for."""

    cmd: list
    executable: str = ''
    namespace: str = ''
    parameters: dict = field(default_factory=dict)
    remappings: dict = field(default_factory=dict)
    respawn: bool = False


class LaunchConfiguration:
    def __init__(self, name):
        self._name = name

    def perform(self, context):
        return context[self._name]


class FindPackageShare:
    def __init__(self, package):
        self.package = package

    def find(self, package):
        return get_package_share_directory(package)


class DeclareLaunchArgument:
    def __init__(self, name, default_value=None, description=''):
        self.name, self.default, self.description = name, default_value, description

    def visit(self, context):
        if self.default is None and self.name not in context:
            raise RuntimeError(f'argument {self.name} is missing')
        context.setdefault(self.name, self.default)
        return []


class OpaqueFunction:
    def __init__(self, function):
        self._function = function

    def visit(self, context):
        return [started for action in self._function(context) for started in action.visit(context)]


class ExecuteProcess:
    def __init__(self, cmd, output='log'):
        self._cmd = cmd

    def visit(self, _context):
        return [Started(list(self._cmd), self._cmd[0])]


class Node:
    def __init__(self, package, executable, name=None, namespace='', parameters=(),
                 remappings=(), arguments=(), output='log', respawn=False, respawn_delay=None):
        self._package, self._name, self._arguments = package, name, arguments
        self._parameters = parameters
        self._started = Started([], executable, namespace, remappings=dict(remappings),
                                respawn=respawn)

    def visit(self, _context):
        started = self._started
        for entry in self._parameters:
            started.parameters.update(entry if isinstance(entry, dict) else {})
        started.cmd = [self._path(), *self._arguments, *self._ros_arguments()]
        return [started]

    def _path(self):
        if self._package != 'mv_slapse':
            return self._started.executable
        return os.path.join(get_package_prefix(self._package), 'lib', self._package,
                            self._started.executable)

    def _ros_arguments(self):
        started, arguments = self._started, ['--ros-args']
        names = {'__node': self._name, '__ns': '/' + started.namespace.strip('/')}
        for source, target in {**names, **started.remappings}.items():
            if target and target != '/':
                arguments += ['-r', f'{source}:={target}']
        for entry in self._parameters:
            file = _parameter_file(entry) if isinstance(entry, dict) else entry
            arguments += ['--params-file', file]
        return arguments


class LaunchDescription:
    def __init__(self, entities=()):
        self.entities = list(entities)


def resolve(path, **arguments) -> list[Started]:
    """Return the processes that a launch file starts with these arguments."""
    context = dict(arguments)
    description = _load(path)
    return [started for entity in description.entities for started in entity.visit(context)]


def _load(path):
    modules = {
        'launch': [LaunchDescription],
        'launch.actions': [DeclareLaunchArgument, ExecuteProcess, OpaqueFunction],
        'launch.substitutions': [LaunchConfiguration],
        'launch_ros': [], 'launch_ros.actions': [Node],
        'launch_ros.substitutions': [FindPackageShare]}
    before = {name: sys.modules.get(name) for name in modules}
    for name, content in modules.items():
        sys.modules[name] = types.ModuleType(name)
        vars(sys.modules[name]).update({item.__name__: item for item in content})
    try:
        return runpy.run_path(str(path))['generate_launch_description']()
    finally:
        for name, module in before.items():
            sys.modules.pop(name)
            if module is not None:
                sys.modules[name] = module


def _parameter_file(parameters: dict) -> str:
    with tempfile.NamedTemporaryFile('w', suffix='.yaml', delete=False) as file:
        yaml.safe_dump({'/**': {'ros__parameters': parameters}}, file)
    return file.name

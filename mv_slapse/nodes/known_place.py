"""``map_file`` and ~/load_map: odom becomes the frame of an earlier run's map."""

from mv_slapse.errors import MvSlapseError, UsageError
from mv_slapse.known_map import KnownMap, PERIOD, place
from mv_slapse.nodes.placement import Placement
from mv_slapse.nodes.settings import SceneOutputSettings
from mv_slapse.nodes.shell import Shell
from mv_slapse.records import SceneEstimate, TrackingStatus
from mv_slapse.ros_frames import RosFrames
from std_srvs.srv import Trigger

MISSING = 'map_file is not set; set it to the map.json of an earlier run'


class KnownPlace:
    """Looks for the planes of a known map, until they tell where the trajectory began in it.

    From then on poses are in the frame of that map: the trajectory is moved once, as by a pose on
    ``initialpose``, and is not compared with the map any more.
    """

    def __init__(self, node: Shell, placement: Placement):
        """Read the map that the parameter names, and offer the service."""
        self._node, self._placement = node, placement
        self._known: KnownMap | None = None
        node.create_service(Trigger, '~/load_map', self._on_load)
        if node.settings[SceneOutputSettings].map_file:
            self._load()
        self.restart()

    def restart(self):
        """Look for the map again, for a trajectory that begins anew."""
        self._is_found, self._due = False, 0
        self._node.health.leave('unplaced')

    def look(self, scene: SceneEstimate, frames: RosFrames) -> RosFrames:
        """Return the placed frames of a scene: its planes may just have been found again."""
        planes = self._known.planes if self._known else scene.planes
        self._placement.settle(scene, frames, planes)
        frames = self._placement.place(frames)
        if (self._known is None or self._is_found or scene.status is not TrackingStatus.OK
                or self._due - PERIOD <= scene.stamp < self._due):
            return frames
        self._due = scene.stamp + PERIOD
        placing = place(self._known, scene, self._placement.start(frames))
        if placing.known_from_world is None:
            self._say(placing.reason)
            return frames
        self._is_found = True
        self._placement.begin_at(placing.known_from_world, frames, planes)
        node = self._node
        node.count_reset()
        said = (f'found again by {len(placing.matches)} planes, within '
                f'{placing.position_sigma:.2f} m')
        node.get_logger().info(f'the known map is {said}; poses are in its frame from now on')
        node.health.value('known map', said)
        node.health.leave('unplaced')
        return self._placement.place(frames)

    def _say(self, reason: str):
        self._node.health.value('known map', f'not found again yet: {reason}')
        self._node.health.enter(
            'unplaced', f'the planes of map_file are not found again: {reason}; tell on '
            'initialpose where it is in that map, or drive on')

    def _load(self):
        # here, so that a robot without the libraries for bags can run the node
        from mv_slapse.storage.archives import read_map
        path = self._node.settings[SceneOutputSettings].map_file
        if not path:
            raise UsageError(MISSING)
        self._known = read_map(path)
        self.restart()
        self._node.health.value('known map', f'{len(self._known.planes)} planes are looked for')

    def _on_load(self, _request, response):
        try:
            self._load()
        except MvSlapseError as error:
            response.success, response.message = False, str(error)
        else:
            response.success = True
            response.message = (f'{len(self._known.planes)} planes are looked for; /diagnostics '
                                'says where they are found')
        return response

"""Where object, tower and place are in a context of pick-and-place.

The thesis fixes object and place, and the context holds two heights. On the field the context holds
where both are, too. The tower stands midway between them, its broad side across the way, always.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

BoolArray = NDArray[np.bool_]
FloatArray = NDArray[np.float64]

OBJECT = np.array([0.62, -0.20])  # m; where the object stands at first in the thesis's arrangement
PLACE = np.array([0.62, 0.20])  # m; where it is to be put down there
HALF_OBJECT, HALF_TOWER = 0.02, 0.03  # m; of the object's square, and of the tower along the carry
LOWEST = np.array([0.02, 0.02])  # m; heights of object and tower that gripper and expert can take
HIGHEST = np.array([0.09, 0.11])  # m
#: m; low and high corner: 30 x 30 cm around where the tower of the thesis's arrangement stands
FIELD = np.array([[0.47, -0.15], [0.77, 0.15]])
#: m; from the tool point to the sides of the open gripper along x and y: palm and fingers
HALF_GRIPPER = np.array([0.024, 0.0545])
ROOM = 0.01  # m; between the tower and the open gripper over object and place, at least

HEIGHT_NAMES = ("object height [m]", "tower height [m]")
FIELD_NAMES = ("object x [m]", "object y [m]", "goal x [m]", "goal y [m]", *HEIGHT_NAMES)


@dataclass(frozen=True)
class Layout:
    """Where things are in N contexts.

    >>> layout = Layout.of([[0.5, -0.1, 0.5, 0.1, 0.06, 0.08]])
    >>> layout.towers.tolist(), layout.directions.tolist(), layout.room.round(4).tolist()
    ([[0.5, 0.0]], [[0.0, 1.0]], [0.0155])

    :param heights: of object and tower, shape (N, 2) in m
    :param objects: where the object stands at first, shape (N, 2) in m
    :param places: where it is to be put down, shape (N, 2) in m
    """

    heights: FloatArray
    objects: FloatArray
    places: FloatArray

    @classmethod
    def of(cls, contexts: ArrayLike) -> "Layout":
        """Return the layout of contexts: the thesis's where they tell heights alone.

        :param contexts: shape (N, 2), or (N, 6) on the field, in m
        """
        given = np.asarray(contexts, np.float64)
        if given.shape[1] == len(FIELD_NAMES):
            return cls(given[:, 4:], given[:, :2], given[:, 2:4])
        n = len(given)
        return cls(given, np.tile(OBJECT, (n, 1)), np.tile(PLACE, (n, 1)))

    @cached_property
    def towers(self) -> FloatArray:
        """The towers' middles, shape (N, 2) in m."""
        return (self.objects + self.places) / 2

    @cached_property
    def distances(self) -> FloatArray:
        """From object to place, shape (N,) in m."""
        return np.linalg.norm(self.places - self.objects, axis=1)

    @cached_property
    def directions(self) -> FloatArray:
        """Unit vectors from object to place, shape (N, 2); along y where both are in one point."""
        way = self.places - self.objects
        way[self.distances == 0] = 0.0, 1.0
        return way / np.linalg.norm(way, axis=1, keepdims=True)

    @cached_property
    def turns(self) -> FloatArray:
        """Angles from y to `directions`, by which the towers are turned, shape (N,) in rad."""
        return np.arctan2(0.0 - self.directions[:, 0], self.directions[:, 1])

    @cached_property
    def crossings(self) -> FloatArray:
        """Points that the tool passes over the tower, in the order of the way, (N, 3, 2) in m.

        Over its middle, and where the object's edge meets the tower's before and behind it.
        """
        along = np.abs(self.directions).sum(axis=1)  # the object's sides stay along x and y
        edge = HALF_TOWER + HALF_OBJECT * along
        steps = edge[:, None] * np.array([-1.0, 0.0, 1.0])
        return self.towers[:, None] + steps[..., None] * self.directions[:, None]

    @cached_property
    def room(self) -> FloatArray:
        """Between the tower and the open gripper over object or place, shape (N,) in m."""
        gripper = np.abs(self.directions) @ HALF_GRIPPER
        return self.distances / 2 - HALF_TOWER - gripper


def draw_field(rng: np.random.Generator) -> FloatArray:
    """Draw heights and object uniformly, and the goal where the tower leaves room, (6,) in m.

    So every point of the field can be object and goal; a goal near the field's middle, from which
    everything is near, is five times rarer than one in a corner.

    :param rng: the generator to draw from
    """
    heights, start = rng.uniform(LOWEST, HIGHEST), rng.uniform(*FIELD)
    while True:
        context = np.concatenate([start, rng.uniform(*FIELD), heights])
        if Layout.of(context[None]).room[0] >= ROOM:
            return context

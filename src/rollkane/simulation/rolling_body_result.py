"""Motion of a body that rolls on or in the rolling body, as a result shows it."""

from typing import Any, Protocol

from jaxtyping import Array, Float

from ..dynamics.abstract_supported import rolling_parts
from ..dynamics.rolling_body_observables import OfRollingBody
from ..validation.checks import FieldError
from .first_pull import first_pull_of
from .samples import Samples


class _Motion(Protocol):
    def each(self, observable: Any) -> Any: ...


class RollingBodyResult:
    """Motion of a body that rolls on or in the rolling body, from the ground up.

    Quantities have the axes of the motion's states in front, as those of the motion.

    Attributes:
        motion: The result that it belongs to.
        path: Index among the bodies that roll on the rolling body; then among those
            that roll on that one, and so on.
    """

    def __init__(self, motion: _Motion, samples: Samples, path: tuple[int, ...]):
        """Look at one body.

        Args:
            motion: A trajectory or an ensemble.
            samples: Its states, with their scene and times.
            path: Which body.

        Raises:
            FieldError: there is no such body.
        """
        scene = samples.scene
        for depth, k in enumerate(path):
            bodies = rolling_parts(scene.supported)
            if not 0 <= k < len(bodies):
                raise FieldError(
                    "rolling_body.path",
                    path,
                    f"names a body that is not there (number {depth + 1} of the path)",
                    f"give numbers below the number of rolling bodies, {len(bodies)}",
                )
            scene = bodies[k].scene
        self.motion, self.path, self._samples = motion, path, samples

    def _each(self, name: str) -> Any:
        return self.motion.each(OfRollingBody(name, self.path))

    @property
    def position(self) -> Float[Array, "T 3"]:
        """Its origin [m], fixed axes, shape (T, 3)."""
        return self._each("position")

    @property
    def velocity(self) -> Float[Array, "T 3"]:
        """Of its origin [m/s], fixed axes, shape (T, 3)."""
        return self._each("velocity")

    @property
    def orientation(self) -> Float[Array, "T 4"]:
        """Unit quaternion, scalar first, its own to fixed axes [1], shape (T, 4)."""
        return self._each("orientation")

    @property
    def angular_velocity(self) -> Float[Array, "T 3"]:
        """Absolute [rad/s], fixed axes, shape (T, 3)."""
        return self._each("angular_velocity")

    @property
    def contact_place(self) -> Float[Array, "T 3"]:
        """Where it touches its carrier [m], fixed axes, shape (T, 3)."""
        return self._each("contact_place")

    @property
    def contact_on_body(self) -> Float[Array, "T 3"]:
        """Contact point from its origin [m], its own axes, shape (T, 3)."""
        return self._each("contact_on_body")

    @property
    def contact_on_carrier(self) -> Float[Array, "T 3"]:
        """Contact point [m], axes of the carrier's surface, shape (T, 3)."""
        return self._each("contact_on_carrier")

    @property
    def contact_force(self) -> Float[Array, "T 3"]:
        """Force of the carrier on it [N], fixed axes, shape (T, 3), (6.2)."""
        return self._each("contact_force")

    @property
    def normal_force(self) -> Float[Array, " T"]:
        """Normal part of the contact force [N], shape (T,); > 0 while pressed."""
        return self._each("normal_force")

    @property
    def friction_ratio(self) -> Float[Array, " T"]:
        """Friction coefficient that rolling needs, ``|T| / N`` [1], shape (T,)."""
        return self._each("friction_ratio")

    @property
    def first_pull(self) -> Float[Array, ""]:
        """When its contact would first have to pull [s]; NaN where it never does.

        The contact is bilateral and the motion runs on.

        Raises:
            FieldError: of ends alone.
        """
        return first_pull_of(self._samples, OfRollingBody("normal_force", self.path))

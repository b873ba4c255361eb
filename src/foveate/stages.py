"""The one place that knows which pictures are of the plane and which of space."""

from foveate.drawing import Stage
from foveate.drawing_spatial import SpatialStage
from foveate.film import Film


def stage_of(film: Film) -> type[Stage] | type[SpatialStage]:
    """What draws a film."""
    return SpatialStage if film.space.dimension == 3 else Stage

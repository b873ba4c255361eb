"""SE(2), SE(3), fields of view as exact signed distances, and the linear algebra of small matrices."""

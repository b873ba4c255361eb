"""The pieces of work that a study makes: what is done in one go, and kept in one file."""

from dataclasses import dataclass
from typing import Literal

from foveate.methods import Method, Training
from foveate.robustness import Factor

InitialError = Literal["paper", "consistent"]


@dataclass(frozen=True, kw_only=True)
class TrainingUnit:
    """One policy to train."""

    training: Training
    seed: int

    @property
    def name(self) -> str:
        """Of its run folder."""
        return f"{self.training.name}-{self.seed}"

    @property
    def file(self) -> str:
        """Where its result is kept."""
        return f"training-{self.name}.json"

    @property
    def what(self) -> str:
        """What is being done."""
        return f"training {self.name}"


@dataclass(frozen=True, kw_only=True)
class RowsUnit:
    """One method to run on all scenes under one protocol and first error; `seed` is that of its training, if any."""

    method: Method
    seed: int | None
    protocol: str
    initial_error: InitialError | None = None

    @property
    def training(self) -> TrainingUnit | None:
        """What has to be done before."""
        return _training_of(self.method, self.seed)

    @property
    def name(self) -> str:
        """Of the method, as one trained with this seed."""
        return _name_of(self.method, self.seed)

    @property
    def file(self) -> str:
        """Where its result is kept."""
        return f"rows-{'-'.join([self.name, self.protocol, *self._error])}.json"

    @property
    def what(self) -> str:
        """What is being done."""
        return ", ".join([self.name, self.protocol, *self._error])

    @property
    def _error(self) -> list[str]:
        return [] if self.initial_error is None else [self.initial_error]


@dataclass(frozen=True, kw_only=True)
class WorldsUnit:
    """One method to run in all worlds of a factor."""

    method: Method
    seed: int | None
    protocol: str
    factor: Factor

    @property
    def training(self) -> TrainingUnit | None:
        """What has to be done before."""
        return _training_of(self.method, self.seed)

    @property
    def file(self) -> str:
        """Where its result is kept."""
        return f"worlds-{_name_of(self.method, self.seed)}-{self.factor.name}.json"

    @property
    def what(self) -> str:
        """What is being done."""
        return f"{_name_of(self.method, self.seed)}, {self.factor.name} changed"


def _training_of(method: Method, seed: int | None) -> TrainingUnit | None:
    return None if method.training is None or seed is None else TrainingUnit(training=method.training, seed=seed)


def _name_of(method: Method, seed: int | None) -> str:
    return method.name if seed is None else f"{method.name}-{seed}"


Unit = TrainingUnit | RowsUnit | WorldsUnit

"""Compiled program and normalized problems of an optimization."""

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..._utils.types import NumbersLike
from ..._utils.validation import compilation_error, quote, require_float64
from ...designs.design_space import DesignSpace
from ..executor import find_program, Program
from ..outputs import StudyOutput
from .limits import Limit
from .options import Options
from .problem import Evaluation, Margins, OutputVector, Problem


# Number of designs that one call of the program evaluates. It is the same for all
# optimizations, so that they share the program. On a processor, the time for each design
# is the same with 8 designs as with 64.
_CPU_DESIGNS, _ACCELERATOR_DESIGNS = 8, 256


class Setup(NamedTuple):
    """Study, objective, and limits of an optimization, and its compiled program.

    Args:
        study: Function of one design.
        objective: Name of the objective.
        sign: 1 if the objective is minimized, -1 if it is maximized.
        limits: Limits of the outputs, by name.
        standard_deviations: Standard deviations of the uncertain parameters, by name.
        coverage_factor: Number of standard deviations at which the limits must hold.
        units: Units of outputs without a unit of their own, by name.
        space: Numbers of the design.
        program: Program that evaluates designs.
        outputs: Order of the outputs in a vector.
    """

    study: Callable[[Any], Any]
    objective: str
    sign: float
    limits: Mapping[str, Limit]
    standard_deviations: Mapping[str, NumbersLike]
    coverage_factor: float
    units: Mapping[str, str]
    space: DesignSpace
    program: Program
    outputs: OutputVector

    @classmethod
    def create(
        cls,
        study: Callable[[Any], Any],
        parameters: Any,
        options: Options,
    ) -> "Setup":
        """Trace the program of an optimization.

        Args:
            study: Function of one design.
            parameters: One design, with its variables.
            options: Options of the optimization.

        Returns:
            The setup.

        Raises:
            ValueError: Double precision is off, or an argument is not valid.
        """
        require_float64(jnp.zeros(()))
        options.check()
        if not callable(study):
            raise ValueError(
                f"`study` is {study!r}, but must be a function of one design."
            )
        limits = dict(options.limits or {})
        standard_deviations = dict(options.standard_deviations or {})
        objective = options.maximize or options.minimize
        assert objective is not None
        space = DesignSpace.from_tree(parameters, standard_deviations)
        on_cpu = jax.default_backend() == "cpu"
        size = _CPU_DESIGNS if on_cpu else _ACCELERATOR_DESIGNS
        names = list(dict.fromkeys([objective, *limits]))
        for name, limit in limits.items():
            if standard_deviations and np.any(limit.lower == limit.upper):
                raise ValueError(
                    f"`limits` prescribes {quote(name)}, which is uncertain because of "
                    "`standard_deviations`. Give two different limits."
                )
        try:
            program = find_program(
                study, space.structure, tuple(names),
                size, math.inf, None, True,
            )  # fmt: skip
        except jax.errors.JAXTypeError as error:
            raise compilation_error("study", "about the design", error) from error
        except ValueError as error:
            message = str(error)
            where = "`limits` names"
            if f"names {quote(objective)}" in message:
                where = f"`{'minimize' if options.maximize is None else 'maximize'}` is"
            message = message.replace("`derivatives` names", where)
            raise ValueError(message) from error
        if unknown := [
            name for name in options.units or {} if name not in program.output.columns
        ]:
            raise ValueError(
                f"`units` names {quote(unknown[0])}, which is not an output of the study."
            )
        outputs = OutputVector.of(program.output, names, space)
        for name in names:
            if np.issubdtype(outputs.columns[name].values.dtype, np.complexfloating):
                raise ValueError(
                    f"The output {quote(name)} is complex, but an objective and a "
                    "limited output must be real. Return its magnitude, `jnp.abs(...)`, "
                    "or its real part."
                )
        shape = outputs.columns[objective].values.shape[1:]
        if shape:
            raise ValueError(
                f"The objective {quote(objective)} has shape {shape}, but must be a "
                "scalar."
            )
        return cls(
            study=study,
            objective=objective,
            sign=1.0 if options.maximize is None else -1.0,
            limits=limits,
            standard_deviations=standard_deviations,
            coverage_factor=float(options.coverage_factor),
            units=dict(options.units or {}),
            space=space,
            program=program,
            outputs=outputs,
        )

    @property
    def unit(self) -> str:
        """Unit of the objective; empty if it is unknown."""
        own = self.outputs.columns[self.objective].unit
        return own or self.units.get(self.objective, "")

    def problem(self) -> Problem:
        """Return the problem, whose objective is not scaled yet."""
        margins = Margins.of(self.limits, self.outputs, self.units, self.coverage_factor)
        return Problem(self.space, margins, self.sign)

    def evaluate(self, vectors: Float[np.ndarray, "designs numbers"]) -> list[Evaluation]:
        """Evaluate designs, in as many calls of the program as they need."""
        size = self.program.chunk_size
        evaluations: list[Evaluation] = []
        for begin in range(0, len(vectors), size):
            chunk = vectors[begin : begin + size]
            count = len(chunk)
            padded = np.concatenate([chunk, np.repeat(chunk[-1:], size - count, axis=0)])
            output = self.program.evaluate(self.space.program_input(padded))
            rows = self.outputs.evaluations(padded, self.space.deviations, output)
            evaluations += rows[:count]
        return evaluations

    def outputs_of(self, vector: Float[np.ndarray, " numbers"]) -> StudyOutput:
        """Return all outputs of the study for one design."""
        repeated = np.repeat(vector[None], self.program.chunk_size, axis=0)
        output = self.program.evaluate(self.space.program_input(repeated))
        return jax.tree.map(lambda leaf: leaf[0], output)

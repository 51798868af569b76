"""What moves, and changes of some values alone: nothing is computed for those that stay."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.extend.core import jaxpr_as_fun, jaxprs_in_params

from jaxlight.lighting.changes import of_some
from jaxlight.lighting.linear_stage import linear_stage
from jaxlight.lighting.moved import moved_by, moved_leaves
from jaxlight.lighting.pruned import pruned

WHICH = jnp.zeros((), jnp.int32)
FACTOR = jnp.asarray(3.0)
HERE = {"a": jnp.asarray(2.0), "b": jnp.asarray(5.0)}


def primitives(jaxpr: Any) -> Iterator[str]:
    for equation in jaxpr.eqns:
        yield equation.primitive.name
        for inner in jaxprs_in_params(equation.params):
            yield from primitives(inner)


def push(change: dict[str, jax.Array]) -> jax.Array:
    """3 * 3 a by a stage that knows b too, and -b, which is no part of it."""
    staged = linear_stage(
        WHICH, [lambda known, own: (known * known * own[0], own[1] / known)], FACTOR, list(change.values())
    )
    return staged[0] - jnp.negative(-change["b"]) + 0.0 * staged[1]


def test_a_linear_function_of_some_changes_computes_nothing_for_the_others() -> None:
    by_a, by_b = (of_some(push, HERE, {"a": own == "a", "b": own == "b"}) for own in "ab")
    assert float(by_a({"a": FACTOR, "b": None})) == 27.0
    assert float(by_b({"a": None, "b": FACTOR})) == -3.0
    program = jax.make_jaxpr(by_a)({"a": FACTOR, "b": None})
    (stage,) = (one for one in program.jaxpr.eqns if one.primitive.name == "linear_stage")
    assert len(stage.invars) - 1 - stage.params["known"] == 1, "of b the stage is given nothing"
    assert not {"neg", "div"} & set(primitives(program.jaxpr))


def test_some_changes_can_be_mapped_and_differentiated() -> None:
    by_a = of_some(push, HERE, {"a": True, "b": False})
    several = jnp.arange(3.0)
    np.testing.assert_array_equal(jax.vmap(by_a)({"a": several, "b": None}), 9 * several)
    assert float(jax.grad(lambda a: by_a({"a": a, "b": None}))(1.0)) == 9.0


def test_a_linear_stage_changes_with_what_it_knows_too() -> None:
    def squared(factor: jax.Array, moving: jax.Array) -> jax.Array:
        return linear_stage(WHICH, [lambda known, own: known * known * own], factor, moving)

    value, change = jax.jvp(squared, (jnp.asarray(3.0), jnp.asarray(2.0)), (jnp.asarray(1.0), jnp.asarray(0.5)))
    assert (float(value), float(change)) == (18.0, 2 * 3 * 2 + 9 * 0.5)


def test_which_leaves_some_numbers_move() -> None:
    def function(at: dict[str, jax.Array]) -> dict[str, Any]:
        both = jax.lax.cond(at["a"] > 0, lambda b: b, lambda b: 2 * b, at["b"])
        return {"a": at["a"] ** 2, "both": both, "neither": jnp.ones(2), "number": jnp.floor(at["a"]).astype(int)}

    by = moved_by(function, HERE)
    assert by({"a": True, "b": False}) == {"a": True, "both": True, "neither": False, "number": False}
    assert by({"a": False, "b": True}) == {"a": False, "both": True, "neither": False, "number": False}
    assert by({"a": False, "b": False}) == dict.fromkeys(["a", "both", "neither", "number"], False)
    assert moved_leaves(function, HERE) == {"a": True, "both": True, "neither": False, "number": False}


@pytest.mark.parametrize(("result", "asked"), [(None, {"sin", "cos"}), (0, {"sin"}), (1, {"cos"})])
def test_a_pruned_function_computes_what_is_asked_for(result: int | None, asked: set[str]) -> None:
    function = jaxpr_as_fun(pruned(jax.make_jaxpr(lambda a, b: (jnp.sin(a), jnp.cos(b)))(1.0, 2.0), result))
    program = jax.make_jaxpr(function)(1.0, 2.0)
    assert set(primitives(program.jaxpr)) == asked
    values = [np.sin(np.float32(1)), np.cos(np.float32(2))]
    np.testing.assert_allclose(function(1.0, 2.0), values if result is None else [values[result]], rtol=1e-6)

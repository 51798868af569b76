# ---
# jupyter:
#   jupytext:
#     formats: py:percent
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # A material from one picture
#
# Given one picture of an object of known shape: what is it made of, and where was the lamp? The picture is Spot the
# cow, rendered by a program that shares nothing with jaxlight and stored in 8 bits
# (`fitting/data/spot/HOW_IT_WAS_MADE.txt` says how). So the answer is known, and rounding to 1/255 is the only noise.

# %%
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import jaxlight as jl
from jaxlight.scene import paths

# A notebook has no file of its own, but the folder that it runs in.
here = Path(globals().get("__file__", "")).resolve()
DATA = next(root for root in (here, *here.parents) if (root / "fitting").is_dir()) / "fitting" / "data" / "spot"
truth = jl.load(DATA / "spot.x3d")
target = jl.read_image(DATA / "spot_256.png")
height, width, _ = target.shape

# %% [markdown]
# ## What is known: shape and camera
#
# Visibility does not depend on materials and lights. It is computed once; the fit only ever evaluates the lighting
# equation on these samples.

# %%
samples = jl.rasterize(truth, jl.Camera.default(truth), width, height)
print(f"{samples.count} samples, {samples.count / (width * height):.0%} of the pixels")

# %% [markdown]
# ## What is not: material and lamp
#
# The start is an honest "no idea": a grey, half shiny material, and a lamp somewhere else. Field paths name numbers of
# the scene as `jaxlight info` lists them.

# %%
FREE = [
    "Material[body].diffuse_color",
    "Material[body].specular_color",
    "Material[body].shininess",
    "PointLight[key].location",
]
START = [
    (lambda s: s.materials.diffuse_color, 0.5),
    (lambda s: s.materials.specular_color, 0.5),
    (lambda s: s.materials.shininess, 0.5),
    (lambda s: s.point.location, np.array([-1.5, 1.0, -3.0])),
]
start = truth
for leaf, value in START:
    start = eqx.tree_at(leaf, start, jnp.broadcast_to(jnp.asarray(value, jnp.float32), leaf(start).shape))


def show(pictures: dict, **options) -> None:
    """Pictures side by side under their titles."""
    figure, axes = plt.subplots(1, len(pictures), squeeze=False, layout="compressed")
    figure.set_size_inches(3.6 * len(pictures), 3.8)
    for axis, (title, image) in zip(axes[0], pictures.items(), strict=True):
        shown = axis.imshow(image if options else np.clip(image, 0, 1), **options)
        axis.set_title(title, fontsize=9)
        axis.axis("off")
    if options:
        figure.colorbar(shown, ax=axes[0], fraction=0.03)
    plt.show()


show({"the picture": target, "the first guess": jl.render(start, samples)})

# %% [markdown]
# ## The fit
#
# Levenberg-Marquardt with the fields' ranges as bounds. Each step evaluates the equation and its derivatives on every
# sample, and solves for the ten free numbers.

# %%
result = jl.fit(start, jl.View(samples, target), FREE)
print(result)

# %%
plt.figure(figsize=(6, 2.8), layout="constrained")
plt.semilogy([step.step for step in result.history], [step.rms for step in result.history], "o-")
plt.axhline(1 / 255 / np.sqrt(12), color="0.6", linestyle="--", label="what rounding to 8 bits leaves")
plt.xlabel("step")
plt.ylabel("residual RMS")
plt.legend()
plt.show()
assert result.converged

# %% [markdown]
# The residual ends where rounding begins: what is left is noise, within half a grey level, and does not look like the
# cow. Neither does its outline, since both programs show what a pixel's centre sees.

# %%
fitted = np.asarray(jl.render(result.scene, samples))
difference = (fitted - target).mean(axis=-1) * 255
show({"fitted": fitted, "the picture": target})
show({"fitted - picture, in 1/255": difference}, cmap="RdBu_r", vmin=-0.5, vmax=0.5)
assert np.abs(difference).max() < 1.0

# %% [markdown]
# ## How right is it?
#
# Against the numbers that the other program was given:

# %%
print(f"{'':32} {'true':>9} {'fitted':>9} {'error':>9}")
for field in paths.fields(truth):
    if field.path in FREE:
        for label, true, found in zip(
            field.labels(truth), np.ravel(field.value(truth)), np.ravel(result.value(field.path)), strict=True
        ):
            print(f"{label:32} {true:9.4f} {found:9.4f} {found - true:9.1e}")
            assert abs(found - true) < 2e-3

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
# # The lighting equation, term by term
#
# VRML97 and X3D give every point of a lit surface the colour (X3D 17.2.2.4)
#
# $$I_{rgb} = I_{Frgb}\,(1 - f_0) + f_0 \Bigl(O_{Ergb} + \sum_i \mathrm{on}_i \times \mathrm{attenuation}_i \times
# \mathrm{spot}_i \times I_{Lrgb} \times (\mathrm{ambient}_i + \mathrm{diffuse}_i + \mathrm{specular}_i)\Bigr)$$
#
# This notebook looks at each term alone, then at the derivative of the picture with respect to single numbers of the
# scene. Those derivatives are what material and light fitting runs on.

# %%
import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import jaxlight as jl
from jaxlight import nodes

jax.config.update("jax_enable_x64", True)  # before the first array: this notebook compares derivatives to many digits
SIZE = 240

# %% [markdown]
# ## A scene
#
# A ball on a table, a point light and a spot light. Nodes are plain Python objects with the specification's names
# (in snake_case), defaults and ranges; a file would give the same objects.


# %%
def make_scene(point=None, spot=None, fog=None, **material) -> jl.Scene:
    """The ball on its table; keyword arguments set fields of the ball's Material."""
    ball = {
        "name": "ball",
        "diffuse_color": (0.75, 0.3, 0.15),
        "specular_color": (0.5, 0.5, 0.5),
        "ambient_intensity": 0.4,
    }
    table = nodes.Material(name="table", diffuse_color=(0.35, 0.45, 0.5), ambient_intensity=0.4)
    lights = {"name": "key", "location": (-2.5, 3.5, 3.0), "attenuation": (0.4, 0.0, 0.05), "ambient_intensity": 1.0}
    cone = {
        "name": "cone",
        "location": (2.5, 4.0, 1.0),
        "direction": (-0.4, -0.9, -0.15),
        "color": (0.5, 0.7, 1.0),
        "beam_width": 0.25,
        "cut_off_angle": 0.55,
    }
    children = [
        nodes.Viewpoint(position=(0.0, 2.2, 5.5), orientation=(1.0, 0.0, 0.0, -0.4), field_of_view=0.62),
        nodes.Shape(appearance=nodes.Appearance(material=nodes.Material(**ball | material)), geometry=nodes.Sphere()),
        nodes.Transform(
            translation=(0.0, -1.1, 0.0),
            children=[nodes.Shape(appearance=nodes.Appearance(material=table), geometry=nodes.Box(size=(9, 0.2, 9)))],
        ),
        nodes.PointLight(**lights | (point or {})),
        nodes.SpotLight(**cone | (spot or {})),
    ]
    return jl.Scene.from_nodes([*children, nodes.Fog(**fog)] if fog else children)


scene = make_scene()
samples = jl.rasterize(scene, jl.Camera.default(scene), SIZE, SIZE)


def picture(values, background=0.0) -> np.ndarray:
    """Values of samples [N] or [N, channels] as a picture."""
    values = np.asarray(values)
    image = np.full((SIZE * SIZE, *values.shape[1:]), background)
    image[np.asarray(samples.pixel)] = values
    return image.reshape(SIZE, SIZE, *values.shape[1:])


def show(pictures: dict, **options) -> None:
    """Pictures side by side under their titles."""
    figure, axes = plt.subplots(1, len(pictures), squeeze=False, layout="compressed")
    figure.set_size_inches(3.1 * len(pictures), 3.3)
    for axis, (title, image) in zip(axes[0], pictures.items(), strict=True):
        shown = axis.imshow(np.clip(image, 0, 1) if image.ndim == 3 else image, **options)
        axis.set_title(title, fontsize=9)
        axis.axis("off")
    if options.get("cmap"):
        figure.colorbar(shown, ax=axes[0], fraction=0.02)
    plt.show()


def shaded(scene: jl.Scene) -> np.ndarray:
    """The colours that the equation gives, as a picture."""
    return picture(jl.shade(scene, samples)[:, :3])


# %% [markdown]
# A renderer's first half is over now: `samples` holds, for every pixel that shows a surface, the point seen there, its
# normal and the viewer's position. Everything below is the second half: the equation on these samples.

# %%
show({"position": picture(samples.position) * 0.15 + 0.5, "normal": picture(samples.normal) * 0.5 + 0.5})

# %% [markdown]
# ## Emissive, ambient, diffuse, specular
#
# - **emissive** $O_{Ergb}$: the Material's `emissiveColor`; needs no light
# - **ambient** $I_{ia} \times O_{Drgb} \times O_a$: light's and material's `ambientIntensity`; knows no direction
# - **diffuse** $I_i \times O_{Drgb} \times (\mathbf{N} \cdot \mathbf{L})$
# - **specular** $I_i \times O_{Srgb} \times (\mathbf{N} \cdot (\mathbf{L}+\mathbf{V}) /
#   \lvert\mathbf{L}+\mathbf{V}\rvert)^{128\,\mathrm{shininess}}$
#
# A term alone is the picture of a scene in which the other terms are zero. The four add up to the picture.

# %%
glowing = make_scene(emissive_color=(0.0, 0.1, 0.2))


def without(scene: jl.Scene, *leaves) -> jl.Scene:
    """The scene with these leaves set to zero."""
    for leaf in leaves:
        scene = eqx.tree_at(leaf, scene, replace_fn=jnp.zeros_like)
    return scene


EMISSIVE = (lambda s: s.materials.emissive_color,)
AMBIENT = (lambda s: s.point.ambient_intensity, lambda s: s.spot.ambient_intensity)
DIFFUSE = (lambda s: s.materials.diffuse_color,)
SPECULAR = (lambda s: s.materials.specular_color,)
DIRECT = (lambda s: s.point.intensity, lambda s: s.spot.intensity)

terms = {
    "emissive": shaded(without(glowing, *AMBIENT, *DIRECT)),
    "ambient": shaded(without(glowing, *EMISSIVE, *DIRECT)),
    "diffuse": shaded(without(glowing, *EMISSIVE, *AMBIENT, *SPECULAR)),
    "specular": shaded(without(glowing, *EMISSIVE, *AMBIENT, *DIFFUSE)),
}
show({**terms, "all": shaded(glowing)})
np.testing.assert_allclose(sum(terms.values()), shaded(glowing), atol=1e-12)

# %% [markdown]
# `shininess` is the exponent in units of 128. At 0 the power is 1 everywhere, at 1 it is 128.

# %%
show({f"shininess {x}": shaded(make_scene(shininess=x)) for x in (0.01, 0.1, 0.4, 1.0)})

# %% [markdown]
# ## attenuation
#
# $\mathrm{attenuation}_i = 1 / \max(c_1 + c_2\,d_L + c_3\,d_L^2,\ 1)$: never above 1, so a point that is near enough
# sees the light at full strength, and the curve has a kink where the sum reaches 1.

# %%
curves = {(1.0, 0.0, 0.0): "constant", (0.0, 0.4, 0.0): "linear", (0.0, 0.0, 0.16): "quadratic"}
distance = np.linspace(0, 8, 200)
plt.figure(figsize=(6, 2.6), layout="constrained")
for (c1, c2, c3), name in curves.items():
    plt.plot(distance, 1 / np.maximum(c1 + c2 * distance + c3 * distance**2, 1), label=f"{name}: {c1}, {c2}, {c3}")
plt.xlabel("$d_L$")
plt.ylabel("attenuation")
plt.legend()
plt.show()
show({name: shaded(make_scene(point={"attenuation": c}, spot={"on": False})) for c, name in curves.items()})

# %% [markdown]
# ## spot
#
# Full strength up to `beamWidth` from the axis, nothing from `cutOffAngle` on, a linear ramp between (table 17.4).
# With `beamWidth` >= `cutOffAngle` there is no ramp, and the edge is a jump.

# %%
cones = {"ramp 0.05 to 0.6": (0.05, 0.6), "ramp 0.4 to 0.6": (0.4, 0.6), "no ramp": (0.6, 0.6)}
show({
    name: shaded(make_scene(point={"on": False}, spot={"beam_width": beam, "cut_off_angle": cut}))
    for name, (beam, cut) in cones.items()
})  # fmt: skip

# %% [markdown]
# ## Fog
#
# $f_0$ is what is left of the surface at the viewer's distance $d_V$ (table 17.5), in one of two ways:
# LINEAR $(v - d_V)/v$ and EXPONENTIAL $\exp(-d_V/(v - d_V))$ with $v$ the `visibilityRange`.

# %%
fog = {"color": (0.7, 0.75, 0.8), "visibility_range": 14.0}
show({
    "no fog": shaded(scene),
    "LINEAR": shaded(make_scene(fog=fog | {"fog_type": "LINEAR"})),
    "EXPONENTIAL": shaded(make_scene(fog=fog | {"fog_type": "EXPONENTIAL"})),
})  # fmt: skip

# %% [markdown]
# ## Derivatives are pictures too
#
# How does every pixel change when one number of the scene does? `jax.jvp` gives that picture in one pass, for any leaf
# of the scene. Red means brighter, blue darker (mean over red, green and blue).

# %%
foggy = make_scene(fog=fog | {"fog_type": "EXPONENTIAL"})

FIELDS = {
    "ball: shininess": (lambda s: s.materials.shininess, 0),
    "ball: diffuse red": (lambda s: s.materials.diffuse_color, (0, 0)),
    "point light: location x": (lambda s: s.point.location, (0, 0)),
    "point light: attenuation c3": (lambda s: s.point.attenuation, (0, 2)),
    "spot light: cutOffAngle": (lambda s: s.spot.cut_off_angle, 0),
    "spot light: direction x": (lambda s: s.spot.direction, (0, 0)),
    "fog: visibilityRange": (lambda s: s.fog.visibility_range, ()),
}


def changed_by(leaf, index, amount):
    """The colours [N, 3] when one number of the foggy scene has grown by `amount`."""
    grown = eqx.tree_at(leaf, foggy, leaf(foggy).at[index].add(amount))
    return jl.shade(grown, samples)[:, :3]


derivatives = {}
for name, (leaf, index) in FIELDS.items():
    _, tangent = jax.jvp(lambda x, leaf=leaf, index=index: changed_by(leaf, index, x), (0.0,), (1.0,))
    derivatives[name] = np.asarray(tangent)

for names in (list(FIELDS)[:4], list(FIELDS)[4:]):
    images = {name: picture(derivatives[name].mean(axis=1)) for name in names}
    images = {name: image / np.abs(image).max() for name, image in images.items()}
    show(images, cmap="RdBu_r", vmin=-1, vmax=1)

# %% [markdown]
# Are they right? Central differences say so, to as many digits as differences have. Pixels at a kink are left out:
# there the left and the right derivative differ, and the equation has none; jaxlight gives a value between the two.

# %%
STEP = 1e-5
print(f"{'field':30} {'largest':>9} {'error':>9} {'kinks':>6}")
for name, (leaf, index) in FIELDS.items():
    one = (changed_by(leaf, index, STEP) - changed_by(leaf, index, -STEP)) / (2 * STEP)
    half = (changed_by(leaf, index, STEP / 2) - changed_by(leaf, index, -STEP / 2)) / STEP
    largest = np.abs(derivatives[name]).max()
    smooth = np.abs(one - half).max(axis=1) < 1e-6 * largest
    error = np.abs(derivatives[name] - half)[smooth].max() / largest
    print(f"{name:30} {largest:9.3g} {error:9.1e} {np.sum(~smooth):6d}")
    assert error < 1e-7 and np.sum(~smooth) < 0.01 * samples.count

# %% [markdown]
# ## Where the equation has kinks
#
# The modified dot product is 0 where the light is behind the surface. At that line, the terminator, the picture is
# continuous, but its derivative with respect to the light's place jumps to 0.

# %%
matte = make_scene(specular_color=(0.0, 0.0, 0.0), point={"ambient_intensity": 0.0}, spot={"on": False})


def moved(x):
    """The red of every sample when the point light has moved by x."""
    return jl.shade(eqx.tree_at(lambda s: s.point.location, matte, matte.point.location.at[0, 0].add(x)), samples)[:, 0]


red, tangent = jax.jvp(moved, (0.0,), (1.0,))
row, columns = 120, slice(60, 180)
figure, (left, right) = plt.subplots(1, 2, figsize=(9, 2.8), layout="constrained")
left.plot(picture(red)[row, columns])
left.set_title("diffuse term along a line across the ball", fontsize=9)
right.plot(picture(tangent)[row, columns])
right.set_title("its derivative by the light's x", fontsize=9)
for axis, quantity in ((left, "red"), (right, "change of red by a unit of x")):
    axis.set_xlabel("pixels along the line")
    axis.set_ylabel(quantity)
plt.show()

# %% [markdown]
# Next: `02_material_from_one_picture.py` turns such derivatives into materials and lights.

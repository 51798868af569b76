"""Textures of saved scenes: copied along, written beside the file, and never over a file that something needs."""

from __future__ import annotations

import base64
import os
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

from jaxlight import Scene, SceneFileWarning, load, read_image, save
from jaxlight.scene import nodes as n
from jaxlight.scene.nodes import nodes_equal
from x3d_text import x3d

TEXTURED = "<Shape><Appearance><Material/><ImageTexture DEF='wood' url='\"maps/wood.png\"'/></Appearance><Box/></Shape>"


@pytest.fixture
def textured(tmp_path: Path) -> Path:
    folder = tmp_path / "source"
    (folder / "maps").mkdir(parents=True)
    Image.fromarray(np.arange(24, dtype=np.uint8).reshape(2, 4, 3)).save(folder / "maps" / "wood.png")
    (folder / "scene.x3d").write_text(x3d(TEXTURED))
    return folder / "scene.x3d"


def with_texels(scene: Scene, image: np.ndarray) -> Scene:
    return eqx.tree_at(lambda s: s.textures[0].image, scene, jnp.asarray(image, dtype=scene.textures[0].image.dtype))


def test_unchanged_textures_are_copied_along(textured: Path, tmp_path: Path) -> None:
    out = tmp_path / "elsewhere" / "scene.x3d"
    out.parent.mkdir()
    scene = load(textured)
    save(scene, out)
    assert out.read_bytes() == textured.read_bytes()
    assert (out.parent / "maps" / "wood.png").read_bytes() == (textured.parent / "maps" / "wood.png").read_bytes()
    assert nodes_equal(load(out).document.children, scene.document.children)


def test_unchanged_textures_make_no_folder_for_the_scene(textured: Path, tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="there is no folder"):
        save(load(textured), tmp_path / "none" / "scene.x3d")
    assert not (tmp_path / "none").exists()


def test_a_copied_texture_never_replaces_another_file(textured: Path, tmp_path: Path) -> None:
    out = tmp_path / "elsewhere" / "fitted.x3d"
    (out.parent / "maps").mkdir(parents=True)
    (out.parent / "maps" / "wood.png").write_text("something else")
    save(load(textured), out)
    assert (out.parent / "maps" / "wood.png").read_text() == "something else"
    assert np.array_equal(load(out).textures[0].image, load(textured).textures[0].image)
    assert "url='\"fitted_wood.png\"'" in out.read_text()


def test_a_scene_behind_a_link_is_at_home_in_the_folder_of_the_link(textured: Path, tmp_path: Path) -> None:
    home = tmp_path / "home"
    home.mkdir()
    (home / "scene.x3d").symlink_to(textured)
    (home / "maps").mkdir()
    Image.new("RGB", (1, 1), (255, 0, 0)).save(home / "maps" / "wood.png")
    scene = load(home / "scene.x3d")
    assert np.ravel(scene.textures[0].image).tolist() == [1, 0, 0]  # not the one beside what the link points to
    for out in (home / "same.x3d", tmp_path / "out.x3d"):
        save(scene, out)
        assert out.read_bytes() == textured.read_bytes()
        assert (out.parent / "maps" / "wood.png").read_bytes() == (home / "maps" / "wood.png").read_bytes()


def test_changed_texels_are_written_beside_the_file(textured: Path) -> None:
    original = (textured.parent / "maps" / "wood.png").read_bytes()
    image = np.random.default_rng(1).integers(0, 256, (5, 3, 3)) / 255
    out = textured.parent / "fitted.x3d"
    save(with_texels(load(textured), image), out)
    assert (textured.parent / "maps" / "wood.png").read_bytes() == original
    assert out.read_text() == x3d(TEXTURED).replace("maps/wood.png", "fitted_wood.png")
    assert np.array_equal(read_image(textured.parent / "fitted_wood.png"), image[::-1])
    assert np.allclose(load(out).textures[0].image, image, atol=1e-7)


def test_an_input_texture_is_never_overwritten(tmp_path: Path) -> None:
    Image.new("RGB", (1, 1), (255, 0, 0)).save(tmp_path / "scene_wood.png")
    (tmp_path / "scene.x3d").write_text(x3d(TEXTURED.replace("maps/wood.png", "scene_wood.png")))
    save(with_texels(load(tmp_path / "scene.x3d"), np.zeros((1, 1, 3))), tmp_path / "scene.x3d")
    assert read_image(tmp_path / "scene_wood.png").ravel().tolist() == [1, 0, 0]
    assert np.array_equal(load(tmp_path / "scene.x3d").textures[0].image, np.zeros((1, 1, 3)))


@pytest.mark.parametrize("replaced", [None, "not XML", x3d("<Shape/>"), x3d(TEXTURED)])
def test_a_file_that_the_replaced_scene_does_not_name_is_never_overwritten(
    tmp_path: Path, replaced: str | None
) -> None:
    (tmp_path / "scene_texture.png").write_text("mine")
    image = np.zeros((1, 2, 3))
    scene = Scene.from_nodes([n.Shape(appearance=n.Appearance(texture=n.ImageTexture(image=image)))])
    if replaced is not None:
        (tmp_path / "scene.x3d").write_text(replaced)
    for _ in range(2):
        save(scene, tmp_path / "scene.x3d")
    assert sorted(os.listdir(tmp_path)) == ["scene.x3d", "scene_texture.png", "scene_texture_2.png"]
    assert (tmp_path / "scene_texture.png").read_text() == "mine"


def test_a_link_to_nothing_is_kept_too(textured: Path) -> None:
    link = textured.parent / "fitted_wood.png"
    link.symlink_to("elsewhere.png")
    save(with_texels(load(textured), np.zeros((1, 1, 3))), textured.parent / "fitted.x3d")
    assert link.is_symlink()
    assert (textured.parent / "fitted_wood_2.png").is_file()


def test_saving_again_replaces_the_textures_of_the_scene_that_it_replaces(textured: Path) -> None:
    scene, out = load(textured), textured.parent / "fitted.x3d"
    (textured.parent / "fitted_wood.png").write_text("mine")
    for level in (0.0, 0.2, 0.4):
        save(with_texels(scene, np.full((1, 1, 3), level)), out)
        assert np.allclose(load(out).textures[0].image, level)
    assert sorted(os.listdir(textured.parent)) == [
        "fitted.x3d", "fitted_wood.png", "fitted_wood_2.png", "maps", "scene.x3d"
    ]  # fmt: skip
    assert (textured.parent / "fitted_wood.png").read_text() == "mine"


def test_changed_pixel_textures_stay_in_the_file(tmp_path: Path) -> None:
    path = tmp_path / "scene.x3d"
    text = x3d("<Shape><Appearance><PixelTexture image='1 2 1 0 255'/></Appearance><Box/></Shape>")
    path.write_text(text)
    save(with_texels(load(path), np.array([[[0.2]], [[0.4]]])), path)
    assert path.read_text() == text.replace("1 2 1 0 255", "1 2 1 0x33 0x66")


def test_a_texture_built_in_python_becomes_a_file(tmp_path: Path) -> None:
    image = np.random.default_rng(2).integers(0, 256, (4, 2, 4)) / 255
    for texture in (n.ImageTexture(image=image, url=("wood.png",)), n.ImageTexture(image=image, name="wood")):
        scene = Scene.from_nodes([n.Shape(appearance=n.Appearance(texture=texture), geometry=n.Box())])
        save(scene, tmp_path / "scene.x3d")
        assert np.array_equal(load(tmp_path / "scene.x3d").document.textures[0].image, image)
    assert sorted(os.listdir(tmp_path)) == ["scene.x3d", "scene_wood.png", "wood.png"]
    named = Scene.from_nodes([n.Shape(appearance=n.Appearance(texture=n.ImageTexture(image=image, url=("wood.png",))))])
    save(named, tmp_path / "again.x3d")
    assert nodes_equal(load(tmp_path / "again.x3d").document.children, named.document.children)


UNUSABLE = {"null": "%00.png", "null in the text": "a\0.png", "too long": "w" * 300 + ".png", "no letter": "\ud800.png"}


@pytest.mark.parametrize("url", UNUSABLE.values(), ids=UNUSABLE)
def test_a_url_that_no_file_can_have_is_replaced_by_a_name_of_the_scene(tmp_path: Path, url: str) -> None:
    image = np.random.default_rng(2).integers(0, 256, (4, 2, 3)) / 255
    texture = n.ImageTexture(image=image, url=(url,))
    save(Scene.from_nodes([n.Shape(appearance=n.Appearance(texture=texture), geometry=n.Box())]), tmp_path / "a.x3d")
    (again,) = load(tmp_path / "a.x3d").document.textures
    assert np.array_equal(again.image, image)
    assert again.url == ("a_texture.png",)


@pytest.mark.parametrize("url", ["%00.png", "w" * 300 + ".png", "loop.png"])
def test_urls_that_name_nothing_stay_as_they_are(tmp_path: Path, url: str) -> None:
    (tmp_path / "loop.png").symlink_to("loop.png")
    path = tmp_path / "scene.x3d"
    path.write_text(x3d(TEXTURED.replace("maps/wood.png", url) + "<Fog visibilityRange='1'/>"))
    with pytest.warns(SceneFileWarning, match=rf"'{url[:50]}.*: no such file beside the scene \(line 3\)"):
        scene = load(path)
    save(eqx.tree_at(lambda s: s.fog.visibility_range, scene, jnp.array(2.0)), tmp_path / "out.x3d")
    assert (tmp_path / "out.x3d").read_text() == path.read_text().replace("Range='1'", "Range='2'")


def test_a_new_texture_does_not_take_the_place_of_a_link(tmp_path: Path) -> None:
    (tmp_path / "wood.png").symlink_to("nowhere.png")
    texture = n.ImageTexture(image=np.ones((1, 1, 3)), url=("wood.png",))
    save(Scene.from_nodes([n.Shape(appearance=n.Appearance(texture=texture), geometry=n.Box())]), tmp_path / "a.x3d")
    assert (tmp_path / "wood.png").is_symlink()
    assert (tmp_path / "a_texture.png").is_file()


def picture(path: Path, level: int) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.new("RGB", (1, 1), (level, level, level)).save(path)
    return path


def levels(scene: Scene) -> list[int]:
    """The first texel of each texture that was read."""
    return [round(255 * float(texture.image[0, 0, 0])) for texture in scene.textures]


def scene_of(folder: Path, *urls: str) -> Path:
    """A scene file with a texture for each of the urls (each in double quotes, or several of them)."""
    folder.mkdir(exist_ok=True)
    shape = "<Shape><Appearance><Material/><ImageTexture url='{}'/></Appearance><Box/></Shape>"
    (folder / "scene.x3d").write_text(x3d("".join(shape.format(url) for url in urls)))
    return folder / "scene.x3d"


@pytest.mark.parametrize("through", ["link.png", "linked/real.png", "linked/../real.png"])
def test_a_texture_behind_a_link_is_copied_to_where_its_url_looks(tmp_path: Path, through: str) -> None:
    source, out = tmp_path / "source", tmp_path / "out"
    path = scene_of(source, f'"{through}"')
    picture(source / "deep" / "maps" / "real.png", 10)
    picture(source / "deep" / "real.png", 10)
    (source / "link.png").symlink_to(Path("deep", "real.png"))
    (source / "linked").symlink_to(Path("deep", "maps"))
    out.mkdir()
    save(load(path), out / "scene.x3d")
    assert (out / "scene.x3d").read_bytes() == path.read_bytes()
    assert levels(load(out / "scene.x3d")) == [10]
    assert not any(file.is_symlink() for file in out.rglob("*"))


@pytest.mark.parametrize(
    ("urls", "own", "strange"),
    [
        ('"nope.png" "ok.png"', "ok.png", "nope.png"),
        ('"a%20b.png"', "a b.png", "a%20b.png"),
        ('"maps\\\\a.png"', "maps/a.png", "maps\\a.png"),
    ],
)
def test_a_saved_scene_shows_no_strange_picture(tmp_path: Path, urls: str, own: str, strange: str) -> None:
    source, out = tmp_path / "source", tmp_path / "out"
    path = scene_of(source, urls)
    picture(source / own, 10)
    picture(out / strange, 200)
    assert levels(load(path)) == [10]
    for _ in range(2):
        save(load(path), out / "scene.x3d")
        assert levels(load(out / "scene.x3d")) == [10]
    assert read_image(out / strange).ravel().tolist() == [200 / 255] * 3
    save(load(path), source / "again.x3d")
    assert (source / "again.x3d").read_bytes() == path.read_bytes()


def test_a_strange_picture_before_one_that_stands_in_the_url_itself_is_not_shown(tmp_path: Path) -> None:
    content = base64.b64encode(picture(tmp_path / "a.png", 10).read_bytes()).decode()
    path, out = scene_of(tmp_path / "source", f'"nope.png" "data:image/png;base64,{content}"'), tmp_path / "out"
    out.mkdir()
    save(load(path), out / "scene.x3d")
    assert (out / "scene.x3d").read_bytes() == path.read_bytes() and os.listdir(out) == ["scene.x3d"]
    picture(out / "nope.png", 200)
    save(load(path), out / "scene.x3d")
    assert levels(load(out / "scene.x3d")) == [10] and len(os.listdir(out)) == 2


def test_a_texture_that_was_missing_does_not_become_a_strange_picture(tmp_path: Path) -> None:
    path, out = scene_of(tmp_path / "source", '"wood.png" "other.png"'), tmp_path / "out"
    picture(out / "wood.png", 200)
    with pytest.warns(SceneFileWarning, match="no such file"):
        scene = load(path)
    save(scene, out / "scene.x3d")
    assert b'"other.png"' in (out / "scene.x3d").read_bytes() and b"wood" not in (out / "scene.x3d").read_bytes()
    with pytest.warns(SceneFileWarning, match="no such file"):
        assert levels(load(out / "scene.x3d")) == []
    picture(path.parent / "wood.png", 10)  # put there meanwhile
    save(scene, path.parent / "again.x3d")
    assert (path.parent / "again.x3d").read_bytes() == path.read_bytes()


def test_no_texture_is_written_through_a_link_to_elsewhere(tmp_path: Path) -> None:
    source, out, elsewhere = (tmp_path / name for name in ("source", "out", "elsewhere"))
    path = scene_of(source, '"sub/in.png"')
    picture(source / "sub" / "in.png", 10)
    out.mkdir()
    elsewhere.mkdir()
    (out / "sub").symlink_to(elsewhere)
    save(load(path), out / "scene.x3d")
    assert os.listdir(elsewhere) == []
    assert levels(load(out / "scene.x3d")) == [10]


@pytest.mark.parametrize("taken", ["ok.png", "scene_ok.png"])
def test_a_folder_of_the_name_of_a_texture_is_let_be(tmp_path: Path, taken: str) -> None:
    source, out = tmp_path / "source", tmp_path / "out"
    path = scene_of(source, '"ok.png"')
    picture(source / "ok.png", 10)
    (out / "ok.png").mkdir(parents=True)
    (out / taken).mkdir(exist_ok=True)
    scene_of(out, f'"{taken}"')  # the replaced scene names it
    save(load(path), out / "scene.x3d")
    assert (out / taken).is_dir()
    assert levels(load(out / "scene.x3d")) == [10]


def test_textures_do_not_come_into_the_way_of_one_another(tmp_path: Path) -> None:
    source, out = tmp_path / "source", tmp_path / "out"
    picture(source / "a" / "c.png", 10)
    picture(source / "b.png", 20)
    (source / "a" / "deep").mkdir()
    (source / "link").symlink_to(Path("a", "deep"))
    for number, urls in enumerate((['"c.png" "b.png"', '"link/../c.png"'], ['"link/../c.png"', '"c.png" "b.png"'])):
        path = scene_of(source, *urls)
        (out / str(number)).mkdir(parents=True)
        save(load(path), out / str(number) / "scene.x3d")
        assert levels(load(out / str(number) / "scene.x3d")) == levels(load(path))


def test_the_name_of_a_new_texture_leads_to_it(tmp_path: Path) -> None:
    """A url is looked for as it stands before `%20` in it becomes a blank."""
    picture(tmp_path / "a%20b_texture.png", 200)
    texture = n.ImageTexture(image=np.zeros((1, 1, 3)))
    scene = Scene.from_nodes([n.Shape(appearance=n.Appearance(texture=texture), geometry=n.Box())])
    save(scene, tmp_path / "a b.x3d")
    assert levels(load(tmp_path / "a b.x3d")) == [0]
    save(scene, tmp_path / ("\u4e00" * 60 + ".x3d"))
    assert levels(load(tmp_path / ("\u4e00" * 60 + ".x3d"))) == [0]


@pytest.mark.parametrize("url", ["a%20b.png", "file:a.png", "a\033.png", ".png"])
def test_a_texture_built_in_python_is_found_again(tmp_path: Path, url: str) -> None:
    picture(tmp_path / "a%20b.png", 200)
    texture = n.ImageTexture(image=np.zeros((1, 1, 3)), url=(url,))
    save(Scene.from_nodes([n.Shape(appearance=n.Appearance(texture=texture), geometry=n.Box())]), tmp_path / "a.x3d")
    assert levels(load(tmp_path / "a.x3d")) == [0]
    assert read_image(tmp_path / "a%20b.png").ravel().tolist() == [200 / 255] * 3


def test_a_texture_of_16_bits_that_did_not_change_keeps_them(tmp_path: Path) -> None:
    grey = np.array([[0, 300], [30000, 65535]], np.uint16)
    source, out = tmp_path / "source", tmp_path / "out"
    source.mkdir()
    out.mkdir()
    Image.fromarray(grey).save(source / "a.png")
    (source / "a.mtl").write_text("newmtl m\nmap_Kd a.png\n")
    (source / "a.obj").write_text(
        "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl m\nf 1/1 2/2 3/3\n"
    )
    save(load(source / "a.obj"), out / "a.x3d")
    np.testing.assert_array_equal(read_image(out / "a.png")[:, :, 0], grey / 65535)


@pytest.mark.parametrize("fate", ["replaced", "gone", "damaged", "written again"])
@pytest.mark.parametrize("place", ["source/scene.x3d", "source/other.x3d", "elsewhere/scene.x3d"])
@pytest.mark.parametrize("url", ["maps/wood.png", "wood.png"])
def test_a_texture_is_saved_as_it_was_loaded_whatever_became_of_its_file(
    tmp_path: Path, fate: str, place: str, url: str
) -> None:
    for name in ("source", "source/maps", "elsewhere"):
        (tmp_path / name).mkdir()
    path, file = tmp_path / "source" / "scene.x3d", tmp_path / "source" / url
    path.write_text(x3d(TEXTURED.replace("maps/wood.png", url)))
    Image.fromarray(np.arange(24, dtype=np.uint8).reshape(2, 4, 3)).save(file)
    scene = load(path)
    if fate == "gone":
        file.unlink()
    elif fate == "damaged":
        file.write_bytes(b"no picture")
    else:
        os.utime(file, ns=(0, 0))
        Image.open(file).copy().save(file) if fate == "written again" else Image.new("RGB", (4, 2), "red").save(file)
    left = file.read_bytes() if file.exists() else None
    save(scene, tmp_path / place)
    assert np.array_equal(load(tmp_path / place).textures[0].image, scene.textures[0].image)
    if left is not None:
        assert file.read_bytes() == left
    is_copy = (tmp_path / place).read_text() == x3d(TEXTURED.replace("maps/wood.png", url))
    assert is_copy or fate != "written again"

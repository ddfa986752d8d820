"""A capture that is shared keeps geometry and calibration, and nothing that tells where or by whom it was taken."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, PngImagePlugin
from skimage.data import astronaut

from anther.cli.main import main
from anther.cli.sample_data import write_samples
from anther.perception import Capture

SECRETS = ("Anna Grower", "Honselersdijk", "/home/anna", "51.99N")


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    """A capture whose files tell names and places in every way that files can; a face is in view 1."""
    write_samples(tmp_path)
    folder = tmp_path / "mine"
    Capture.load(tmp_path / "capture").select([0, 1, 2]).save(folder)  # faces take half a second a view
    told = json.loads((folder / "transforms.json").read_text())
    for frame in told["frames"]:
        path = folder / frame["file_path"]
        texts = PngImagePlugin.PngInfo()
        texts.add_text("Author", SECRETS[0])
        exif = Image.Exif()
        exif[0x010E] = SECRETS[1]
        Image.open(path).save(path, pnginfo=texts, exif=exif)
        named = path.with_name(f"anna-{path.name}")
        path.rename(named)
        frame |= {"file_path": f"rgb/{named.name}", "note": SECRETS[2]}
    told |= {"operator": SECRETS[0], "gps": SECRETS[3]}
    (folder / "transforms.json").write_text(json.dumps(told))
    (folder / "readme.txt").write_text(SECRETS[1])
    face = np.array(Image.fromarray(astronaut()[:256, 96:352]))
    path = folder / told["frames"][1]["file_path"]
    image = np.array(Image.open(path).convert("RGB"))
    size = min(256, *image.shape[:2])
    image[:size, :size] = np.array(Image.fromarray(face).resize((size, size)))
    Image.fromarray(image).save(path)
    return folder


def test_what_tells_names_and_places_is_left_behind_and_geometry_is_kept(capture: Path, tmp_path: Path, capsys) -> None:
    out = tmp_path / "shared"
    assert main(["import", "share", str(capture), str(out), "--crop", "tomato", "--licence", "CC-BY-4.0"]) == 0
    said = capsys.readouterr().out
    before, after = Capture.load(capture), Capture.load(out)
    written = b"".join(path.read_bytes() for path in out.rglob("*") if path.is_file())
    assert not [secret for secret in SECRETS if secret.encode() in written]
    assert {path.relative_to(out).parts[0] for path in out.rglob("*")} == {
        "transforms.json",
        "share.json",
        "rgb",
        "depth",
    }
    assert all(path.stem.isdecimal() for path in out.rglob("*.png"))
    assert after.intrinsics == before.intrinsics
    np.testing.assert_allclose(after.T_world_cam, before.T_world_cam, atol=1e-9)
    about = json.loads((out / "share.json").read_text())
    assert (about["crop"], about["licence"], about["views"]) == ("tomato", "CC-BY-4.0", before.views)
    hidden = np.zeros(before.depth.shape, bool)
    for box in about["masked"]:
        hidden[box["view"], box["y"] : box["y"] + box["height"], box["x"] : box["x"] + box["width"]] = True
    assert hidden[1].any(), "the face"
    assert "view 1: a face at" in said
    assert "Look at every image" in said
    assert (after.depth[hidden] == 0).all()
    np.testing.assert_array_equal(after.rgb[~hidden], before.rgb[~hidden])
    assert np.ptp(after.rgb[hidden]) == 0
    np.testing.assert_allclose(after.depth[~hidden], before.depth[~hidden], atol=6e-5)


def test_boxes_by_hand_and_an_archive(capture: Path, tmp_path: Path) -> None:
    out = tmp_path / "shared.zip"
    words = ["--no-faces", "--mask", "0:1,2,3,4", "all:0,0,2,2"]
    assert main(["capture", "share", str(capture), str(out), *words]) == 0
    with zipfile.ZipFile(out) as archive:
        assert {entry.date_time for entry in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}
        archive.extractall(tmp_path / "there")
    found = Capture.load(tmp_path / "there" / "capture")
    about = json.loads((tmp_path / "there" / "capture" / "share.json").read_text())
    assert len(about["masked"]) == 1 + found.views
    assert (found.rgb[0, 2:6, 1:4] == 128).all()
    assert (found.rgb[:, :2, :2] == 128).all()
    assert main(["capture", "share", str(capture), str(out)]) == 2, "nothing is overwritten"


@pytest.mark.parametrize("box", ["0:0,0,1,1000000", "99:0,0,5,5", "0:0,0,0,5", "0:1,2,3", "x:0,0,5,5"])
def test_a_box_that_is_none_is_refused(capture: Path, tmp_path: Path, capsys, box: str) -> None:
    assert main(["import", "share", str(capture), str(tmp_path / "o"), "--mask", box]) == 2
    assert "VIEW:X,Y,WIDTH,HEIGHT" in capsys.readouterr().err
    assert not (tmp_path / "o").exists()


def test_the_original_stays(capture: Path, capsys) -> None:
    assert main(["import", "share", str(capture), str(capture), "--overwrite"]) == 2
    assert "the capture itself" in capsys.readouterr().err

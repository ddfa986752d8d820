"""Inputs of the kind that people reported elsewhere: are they taken rightly, refused in words, wrongly, or not at all?

The folder is ../shared/reports beside the checkout (ANTHER_REPORTS names another); its README tells of each input what
is right. Each is run as its README says, in a copy, and judged by numbers that are written there. A link that the
folder keeps as git keeps it (a file with the way) is made one again. --quick runs those that take less than a second;
--seed orders them.

Keys of the --json file: kinds, right (also those refused where the README allows it), refused, wrong_silently (exit
code 0 and not right), crashes (a traceback), and <number>: 1 right, 0 not.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import shutil
import tempfile
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from anther.cli.main import main as anther
from anther.cli.sample_data import write_samples
from anther.core import Array, inverse
from anther.core.geometry import transform_from_pose7
from anther.history.sweep import read_table
from anther.perception import Capture, Cloud, read_cloud
from anther.robot import read_cell
from evaluation.harness import finish, options, progress
from evaluation.tables import markdown

REPORTS = Path(os.environ.get("ANTHER_REPORTS", Path(__file__).parents[3] / "shared" / "reports"))
T_FLANGE_CAM = transform_from_pose7([0.031, -0.062, 0.048, 0.061834, -0.011263, 0.719185, 0.691970])
T_BASE_CAM = transform_from_pose7([0.9, -0.5, 0.4, -0.604288, -0.470457, 0.438380, 0.470457])
STEM, STEM_WITHIN = 0.40, 0.01
DENSITY = 1077.0
SHAKE = [
    "--grip", "15", "--flower", "41", "--amplitude", "0.004", "--frequency", "1.3", "--duration", "2", "--dt", "0.005",
    "--density", "1100", "--bend-over-twist", "1.5",
]  # fmt: skip
CHARUCO = "charuco:7x5:30mm:22mm"


class Ran(NamedTuple):
    """What a command did: exit code, all that it printed, its standard output, whether it ended in a traceback."""

    code: int
    text: str
    answer: str
    crashed: bool = False


def run(*arguments: object) -> Ran:
    """Run an anther command."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = anther([str(a) for a in arguments])
        except SystemExit as end:
            code = int(end.code or 0) if not isinstance(end.code, str) else 1
        except Exception:
            return Ran(1, out.getvalue() + err.getvalue() + traceback.format_exc(), out.getvalue(), crashed=True)
    return Ran(code, out.getvalue() + err.getvalue(), out.getvalue())


class Crash(Exception):
    """A command ended in a traceback."""


Check = Callable[[Path], str]
"""Takes a new folder, returns "right", "refused" or what is wrong; may raise `Crash`."""


def told(ran: Ran, *words: str) -> str:
    """Return "refused" if the command ended with code 2, one message and these words in it, else what it did."""
    if ran.crashed:
        raise Crash(ran.text.splitlines()[-1])
    if ran.code == 0:
        return "taken without a word"
    missing = [word for word in words if not re.search(word, ran.text)]
    return "refused" if ran.code == 2 and not missing else f"exit {ran.code}, not named: {', '.join(missing)}"


def done(ran: Ran) -> None:
    """Raise what a command that should succeed said instead."""
    if ran.crashed:
        raise Crash(ran.text.splitlines()[-1])
    if ran.code:
        raise ValueError(f"exit {ran.code}: {ran.text.strip().splitlines()[-1][:200]}")


def near(value: float, wanted: float, within: float, what: str) -> str:
    """Return "right", or what the value is instead."""
    return "right" if abs(value - wanted) <= within else f"{what} {value:.4g} instead of {wanted:g}"


def apart(found: Array, wanted: Array, millimetres: float, degrees: float) -> str:
    """Return "right" where (.., 4, 4) poses are as near as asked, or by how much they are apart."""
    gap = inverse(wanted) @ found
    turn = float(np.rad2deg(Rotation.from_matrix(gap[..., :3, :3]).magnitude().max()))
    shift = 1e3 * float(np.linalg.norm(gap[..., :3, 3], axis=-1).max())
    return "right" if shift <= millimetres and turn <= degrees else f"off by {shift:.2f} mm, {turn:.3f} deg"


def stem(path: str, *options: str) -> Check:
    def check(out: Path) -> str:
        ran = run("skeletonize", path, *options, "--up", "z", "--json", "--out", out)
        done(ran)
        return near(json.loads(ran.answer)["stem_length"], STEM, STEM_WITHIN, "stem")

    return check


def colours(out: Path) -> str:
    found = read_cloud("02_named_columns/xyzirgb_m.xyz", "m", "z").colors
    wanted = {(60, 140, 50), (60, 150, 50), (240, 210, 40)}
    own = set() if found is None else {tuple(c) for c in np.unique(found, axis=0).tolist()}
    return stem("02_named_columns/xyzirgb_m.xyz", "--units", "m")(out) if own == wanted else f"colours {own}"


def true_poses(path: str) -> Array:
    """Return the poses that a file of the folder states, by frame."""
    return np.array(json.loads(Path(path).read_text()), dtype=np.float64)


def imported(source: str, poses: str, *options: str, depth: str = "", exact: bool = False) -> Check:
    def check(out: Path) -> str:
        done(run("import", source, out / "c", *options))
        capture, wanted = Capture.load(out / "c"), true_poses(poses)
        if len(capture.T_world_cam) != len(wanted):
            return f"{len(capture.T_world_cam)} of {len(wanted)} views"
        if depth:
            true = np.load(depth)
            true = true[true.files[0]]
            seen = (true > 0) & (capture.depth > 0)
            off = np.abs(capture.depth - true)[seen] / true[seen]
            if seen.sum() < 0.99 * (true > 0).sum() or off.max() > (2e-4 if exact else 0.01):
                return f"depth off by {off.max():.2%}"
        return apart(capture.T_world_cam, wanted, 1.0, 0.1)

    return check


def reconstructed(path: str, within: float) -> Check:
    """As many points as the README tells of 07a, to within a share."""

    def check(out: Path) -> str:
        done(run("reconstruct", path, "--out", out / "run"))
        points = len(Cloud.load(next((out / "run").glob("*cloud.ply"))).points)
        return near(points / 11469, 1.0, within, "points over those of 07a")

    return check


def board(name: str, *, pose: str = "camera", **options: str) -> Ran:
    """Calibrate on a board of the folder."""
    folder = Path(name) / "board" if (Path(name) / "board").is_dir() else Path(name)
    given = {"images": folder, "poses": folder / "poses.csv", "board": CHARUCO, "intrinsics": folder / "camera.json"}
    words = [w for key, value in (given | options).items() for w in (f"--{key.replace('_', '-')}", value) if w != ""]
    return run("calibrate", *words, "--json")


def calibrated(name: str, key: str, wanted: Array, millimetres: float, degrees: float, **options: str) -> Check:
    def check(out: Path) -> str:
        ran = board(name, out=str(out), **options)
        done(ran)
        return apart(np.array(json.loads(ran.answer)[key]), wanted, millimetres, degrees)

    return check


def small_board(out: Path) -> str:
    ran = board("11_board_printed_at_97_percent", out=str(out))
    done(ran)
    square = re.search(r"3\.0 % smaller.*squares of ([0-9.]+) mm", " ".join(json.loads(ran.answer)["notes"]))
    return near(float(square[1]), 29.1, 0.05, "squares") if square else "no warning"


def beside_robot(out: Path) -> str:
    first = told(board("12_eye_to_hand", out=str(out)), "--eye-to-hand")
    second = calibrated("12_eye_to_hand", "T_base_cam", T_BASE_CAM, 1.0, 0.1, eye_to_hand="")(out)
    return second if first == "refused" else first


def old_board(out: Path) -> str:
    name = "14_board_of_old_opencv"
    first = told(board(name, board="charuco:7x6:30mm:22mm", out=str(out)), ":legacy")
    legacy = "charuco:7x6:30mm:22mm:DICT_4X4_50:legacy"
    second = calibrated(name, "T_flange_cam", T_FLANGE_CAM, 1.0, 0.1, board=legacy)(out)
    return first if second == "right" else second


def shaken(file: str, frequency: float | None, *options: str, words: tuple[str, ...] = ()) -> Check:
    """The first natural frequency [Hz] to 1 %, or, of None, a refusal with these words."""

    def check(out: Path) -> str:
        ran = run("plan", f"15_swc/{file}", "--simulate", "--bare", *SHAKE, *options, "--json")
        if frequency is None:
            return told(ran, *words)
        done(ran)
        found = json.loads(ran.answer)["first_frequency_hz"]
        return near(found, frequency, 0.025 * frequency, "frequency")

    return check


def cell(name: str, *words: str) -> Check:
    def check(out: Path) -> str:
        path = f"16_urdf/{name}/my_cell.toml"
        ran = run("cell", "check", path)
        if ran.code or ran.crashed or words:
            return told(ran, *words)
        widest = max(c.radius for link in read_cell(path).model.links for c in link.capsules)
        return "right" if widest < 0.5 else f"a capsule of {widest:.1f} m"

    return check


def density(file: str) -> Check:
    def check(out: Path) -> str:
        ran = run("identify", "--samples", f"17_excel_tables/{file}", "--out", out)
        done(ran)
        found = re.search(r"density\s+([0-9.]+) ± ([0-9.]+)", ran.text)
        return near(float(found[1]), DENSITY, 1.0, "density") if found else "no density"

    return check


def swept(file: str) -> Check:
    def check(out: Path) -> str:
        rows = read_table(f"17_excel_tables/{file}")
        return "right" if rows == [{"plant": "tomato", "seed": "0", "viewpoint": "0"}] else f"rows {rows}"

    return check


def measured(out: Path) -> str:
    ran = run("traits", "18_foreign_files_in_a_folder/clouds", "--units", "m", "--up", "z", "--out", out)
    done(ran)
    lengths = [float(value) for value in re.findall(r": stem ([0-9.]+) m", ran.text)]
    return near(lengths[0], STEM, STEM_WITHIN, "stem") if len(lengths) == 2 else f"{len(lengths)} plants"


def inverted(out: Path) -> str:
    write_samples(out / "samples")
    shutil.copy("19_world_to_camera/transforms.json", out / "samples/capture/transforms.json")
    return told(run("reconstruct", out / "samples/capture", "--out", out / "run"), "every pose were inverted")


POSES_17 = "17_excel_tables/poses_tab_decimal_comma.csv"
BOARD_13 = "13_pixel_centre_of_transforms_json"
HALF_PIXEL = f"{BOARD_13}/board/transforms.json"
STIFF = ("--youngs", "100")
KINDS: dict[str, Check] = {
    "01": stem("01_decimal_comma/plant_mm.xyz", "--units", "mm"),
    "02a": stem("02_named_columns/intensity_first_mm.csv", "--units", "mm"),
    "02b": stem("02_named_columns/index_first_m.xyz", "--units", "m"),
    "02c": colours,
    "03": stem("03_ply_list_in_vertex/views.ply", "--units", "m"),
    "04": imported("04_zed_pose_of_the_body/zed", "04_zed_pose_of_the_body/true_T_world_cam.json"),
    "05a": imported(
        "05_compressed_depth/metres",
        "05_compressed_depth/true_T_world_cam.json",
        depth="05_compressed_depth/true_depth_m.npz",
    ),
    "05b": imported(
        "05_compressed_depth/png16",
        "05_compressed_depth/true_T_world_cam.json",
        depth="05_compressed_depth/true_depth_m.npz",
        exact=True,
    ),
    "06": lambda out: told(
        run("reconstruct", "06_depth_steps_of_a_tenth_mm/capture", "--out", out), "depth_unit_scale_factor"
    ),
    "07a": reconstructed("07_from_windows/backslash", 0.01),
    "07b": calibrated(BOARD_13, "T_flange_cam", T_FLANGE_CAM, 0.2, 0.015, intrinsics="07_from_windows/camera_bom.json"),
    "08": reconstructed("08_intrinsics_per_frame/capture", 0.02),
    "09": imported(
        "09_colmap_text_without_empty_lines/dense",
        "09_colmap_text_without_empty_lines/dense/true_T_world_cam.json",
        "--scale", "0.13", "--up=z",
    ),
    "10": calibrated("10_lens_of_eight_numbers", "T_flange_cam", T_FLANGE_CAM, 1.0, 0.1),
    "11": small_board,
    "12": beside_robot,
    "13": calibrated(BOARD_13, "T_flange_cam", T_FLANGE_CAM, 0.2, 0.015, intrinsics=HALF_PIXEL),
    "14": old_board,
    "15a": shaken("seedling_cm.swc", None, words=("--units cm",)),
    "15a cm": shaken("seedling_cm.swc", 9.35, "--units", "cm"),
    "15b": shaken("duplicate_fork.swc", 3.404),
    "15c": shaken("tip0.swc", 3.404),
    "15d": shaken("parent0.swc", 3.404),
    "16a": cell("collada_mm"),
    "16b": cell("degrees", "143"),
    "16c": cell("zero_limits", "j0", "velocity|effort"),
    "16d": cell("continuous_without_limit", "j5", "limit"),
    "16e": cell("package_mesh", "packages"),
    **{
        f"17{letter}": density(file)
        for letter, file in zip(
            "abcdef",
            ("sep.csv", "trailing_cols.csv", "trailing_rows.csv", "utf16.txt", "cp1252.csv", "quoted_comma.csv"),
            strict=True,
        )
    },
    "17g": calibrated(BOARD_13, "T_flange_cam", T_FLANGE_CAM, 0.2, 0.015, poses=POSES_17),
    "17h semicolons": swept("sweep_semi2.csv"),
    "17h blank": swept("sweep_blank.csv"),
    "18": measured,
    "19": inverted,
    "20a": shaken("good.swc", None, "--youngs", "100e6", "--density", "1.05", words=("density", "5000")),
    "20b": shaken("good.swc", None, *STIFF, words=("allowed: 10000 <= youngs",)),
}  # fmt: skip
"""By the number of their line in the folder's README."""
SLOW = {"06", "07a", "08", "18", "19"}
"""Those that take more than a few seconds."""


@contextlib.contextmanager
def in_copy() -> Iterator[Path]:
    """Go into a copy of the folder that may be written, with its links made links; come back after."""
    before = Path.cwd()
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "reports"
        shutil.copytree(REPORTS, folder, symlinks=True, copy_function=shutil.copyfile)
        for path in folder.rglob("*"):
            path.chmod(0o755 if path.is_dir() else 0o644)
            if path.suffix == ".py":  # written for the places that these modules had
                text = path.read_text().replace("anther.devices", "anther.robot.devices")
                path.write_text(text.replace("anther.geometry", "anther.core.geometry"))
        link = folder / "18_foreign_files_in_a_folder/clouds/day 2"
        if link.is_file():
            way = link.read_text().strip()
            link.unlink()
            link.symlink_to(way)
        os.chdir(folder)
        try:
            yield folder
        finally:
            os.chdir(before)


def judged(name: str, out: Path) -> str:
    """Return "right", "refused", "crash: ..." or what is wrong."""
    try:
        return KINDS[name](out)
    except Crash as error:
        return f"crash: {error}"
    except ValueError as error:  # refused, where it should not be
        return f"{error}"


def main() -> None:
    """Judge every input, print and write what became of them."""
    quick, seed = "without those that take more than a few seconds", (0, "of the order in which they are run")
    args = options(__doc__, quick=quick, seed=seed)
    if not REPORTS.is_dir():
        raise SystemExit(f"{REPORTS} is missing; ANTHER_REPORTS names the folder")
    names = [name for name in KINDS if not (args.quick and name in SLOW)]
    order = np.random.default_rng(args.seed).permutation(len(names))
    found = dict[str, str]()
    with in_copy(), tempfile.TemporaryDirectory() as place:
        for number in progress(order.tolist(), "inputs"):
            out = Path(place) / str(number)
            out.mkdir()
            found[names[number]] = judged(names[number], out)
    right = sum(verdict in ("right", "refused") for verdict in found.values())
    crashes = sum(verdict.startswith("crash") for verdict in found.values())
    refused = sum(verdict.startswith("exit") for verdict in found.values())
    result = {
        "kinds": len(names),
        "right": right,
        "refused": sum(verdict == "refused" for verdict in found.values()),
        "wrong_silently": len(names) - right - crashes - refused,
        "crashes": crashes,
    }
    each = {name.replace(" ", "_"): int(found[name] in ("right", "refused")) for name in names}
    words = ", ".join(f"{name.replace('_', ' ')} {count}" for name, count in result.items())
    finish(args, result | each, markdown(("input", "found"), [(name, found[name]) for name in names]), f"{words}.")


if __name__ == "__main__":
    main()

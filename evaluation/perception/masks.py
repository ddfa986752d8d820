"""Masks in every light: simulated plants against the truth, bleeding masks freed of the pot, real Arabidopsis views.

Each plant is seen by the arm's views with all errors of pose, depth and colour, once in each light or setting. One
parameter set for all; nothing is told which light it is.

Keys of the --json file. <species>_<light>_...: iou (plant and flower pixels among all pixels, all views pooled),
iou_with_depth (only pixels that have a depth reading), flower_recall and flower_precision (of pixels), flowers_found
(share of the flowers seen by three views or more that have a flower point of the cloud within 15 mm),
pot_soil_in_cloud and other_in_cloud (share of the fused cloud's points nearest to pot or soil; to bench, stake or
string), s (wall seconds of the mask stage), cpu_s. bleed_<kind>_<species>_...: plant_kept (share of the plant's pixels
that without_ground leaves), pot_soil_in_cloud, foot_mm (where the stem's points begin above the soil). iou_min,
iou_with_depth_min, pot_soil_in_cloud_max: over all rows. romi_...: share of the checked views in which all points on
the stem and on leaves are covered (a mask pixel within 2 px, the precision of the hand), share of background points
that are masked.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from rich.console import RenderableType
from scipy.spatial import KDTree

from anther.core import Box
from anther.core.files import read_json
from anther.perception import Capture, Masks, cloud, masks
from anther.perception.masks import FLOWER, PLANT
from anther.plant import Crop
from anther.robot.arm.views import Params as ViewParams
from anther.sim import CaptureTruth, Organ, Scene, SimPlant, grow, layout, photograph, views_at
from anther.sim.greenhouse import Setting
from anther.sim.simulated_cell import USUAL_DISTANCE
from evaluation.harness import CROPS, DATA, finish, options, progress
from evaluation.perception.colour_images import segment_images
from evaluation.tables import by_part, written

CHECK = Path(__file__).with_name("romi_arabidopsis_check.json")
WHITE_FILM = (236, 238, 238)
SETTINGS = {
    "daylight": Setting(),
    "warm": Setting(light=((1.5, 0, 0), (0, 1, 0), (0, 0, 0.33))),
    "cold": Setting(light=((0.5, 0, 0), (0, 0.95, 0), (0, 0, 1.5))),
    "shade": Setting(sun=False),
    "dim": Setting(light=((0.12, 0, 0), (0, 0.12, 0), (0, 0, 0.12)), sun=False),
    "brown_pot": Setting(pot=(178, 98, 66)),
    "black_pot": Setting(pot=(42, 42, 45), soil=(30, 28, 27)),
    "white_film": Setting(soil=WHITE_FILM, bench=WHITE_FILM),
    "red_led": Setting(light=((0.80, 0, 0.02), (0.06, 0, 0.05), (0.02, 0, 0.32))),
    "stake": Setting(stake=True),
    "greenery": Setting(greenery=True),
}
"""Estimates, all: a camera balanced for daylight under lamps of about 3000 K (warm), one balanced for lamps under a
blue sky (cold), three stops too dark (dim), grow lamps of 660 nm and some 450 nm, whose red and blue leak into the
green channel (red_led)."""
QUICK = ("daylight", "warm", "dim", "red_led", "stake")
PICTURED = 14  # the view shown in the picture


GREEN, MAGENTA = (60, 220, 60), (230, 40, 230)


def taken(plant: SimPlant, setting: Setting, seed: int, count: int) -> tuple[Capture, CaptureTruth, Box, Scene]:
    """Return what the arm's views of a plant show, the truth, the workspace and the scene."""
    views = views_at(USUAL_DISTANCE, ViewParams(count=count))
    scene = Scene.of_plant(plant, setting)
    return *photograph(scene, views.joints, seed), layout(USUAL_DISTANCE).workspace, scene


def score(found: Masks, capture: Capture, truth: CaptureTruth) -> dict[str, float]:
    """Compare masks with the truth, pixel by pixel, all views pooled."""
    plant, masked, seen = truth.organ <= Organ.FLOWER, found.labels > 0, capture.depth > 0
    flower, petal = truth.organ == Organ.FLOWER, found.labels == FLOWER
    return {
        "iou": _ratio(plant & masked, plant | masked),
        "iou_with_depth": _ratio(plant & masked & seen, (plant | masked) & seen),
        "flower_recall": _ratio(flower & petal, flower),
        "flower_precision": _ratio(flower & petal, petal),
    }


def score_cloud(fused: cloud.Cloud, plant: SimPlant, scene: Scene, truth: CaptureTruth) -> dict[str, float]:
    """Say what the points of a cloud lie on, and which flowers they show."""
    points, organ = _surface_points(scene)
    nearest = organ[np.asarray(KDTree(points).query(fused.points)[1])]
    looks = [scene.visible(plant.flower_position, eye, tolerance=0.012) for eye in truth.T_world_cam[:, :3, 3]]
    shown = plant.flower_position[np.sum(looks, axis=0) >= 3]
    petals = fused.points[fused.labels == FLOWER] if fused.labels is not None else np.zeros((0, 3))
    away = np.asarray(KDTree(petals).query(shown)[0]) if len(petals) and len(shown) else np.full(len(shown), np.inf)
    return {
        "flowers_found": float((away < 0.015).mean()) if len(shown) else float("nan"),
        "pot_soil_in_cloud": float(np.isin(nearest, [Organ.POT, Organ.SOIL]).mean()),
        "other_in_cloud": float((nearest == Organ.BENCH).mean()),
    }


def in_one_light(plant: SimPlant, name: str, count: int) -> tuple[dict[str, float], NDArray[Any]]:
    """Return the metrics of one plant in one light, and a picture."""
    capture, truth, workspace, scene = taken(plant, SETTINGS[name], plant.seed, count)
    begin, begin_cpu = time.perf_counter(), time.process_time()
    found = masks.segment(capture, workspace)
    seconds = {"s": time.perf_counter() - begin, "cpu_s": time.process_time() - begin_cpu}
    fused = cloud.fuse(capture, found, workspace)
    values = score(found, capture, truth) | score_cloud(fused, plant, scene, truth) | seconds
    view = min(PICTURED, capture.views - 1)
    assert capture.rgb is not None
    return values, overlaid(capture.rgb[view], found.labels[view])


def bleeding(plant: SimPlant, count: int) -> dict[str, float]:
    """Free masks that bleed like SAM 2's of the pot: with all of pot and soil, or 12 px too wide everywhere."""
    capture, truth, workspace, scene = taken(plant, Setting(), plant.seed, count)
    is_plant = truth.organ <= Organ.FLOWER
    window = np.ones((25, 25), np.uint8)
    wrong = {
        "pot": is_plant | np.isin(truth.organ, [Organ.POT, Organ.SOIL]),
        "wide": np.stack([cv2.dilate(view.astype(np.uint8), window) for view in is_plant]) > 0,
    }
    values = {}
    for kind, labels in wrong.items():
        freed = masks.without_ground(Masks(labels.astype(np.uint8), kind), capture, workspace)
        fused = cloud.fuse(capture, freed, workspace)
        beside = np.hypot(*(fused.points - plant.pot.centre)[:, :2].T) < 0.03
        row = {
            "plant_kept": _ratio(is_plant & (freed.labels > 0), is_plant),
            "pot_soil_in_cloud": score_cloud(fused, plant, scene, truth)["pot_soil_in_cloud"],
            "foot_mm": 1e3 * float(np.percentile(fused.points[beside, 2], 0.5) - plant.pot.centre[2]),
        }
        values |= {f"bleed_{kind}_{plant.species}_{name}": value for name, value in row.items()}
    return values


def arabidopsis(folder: Path) -> dict[str, float]:
    """Compare the colour-only masks of the real views with the points that a hand placed."""
    points = read_json(CHECK)
    rgb = np.stack([np.asarray(cv2.imread(str(folder / name)))[..., ::-1] for name in points])
    begin = time.perf_counter()
    found = segment_images(rgb)
    seconds = time.perf_counter() - begin
    near = [cv2.dilate((labels > 0).astype(np.uint8), np.ones((5, 5), np.uint8)) for labels in found.labels]
    stem, leaf = (
        [all(view[v, u] for u, v in marks[part]) for view, marks in zip(near, points.values(), strict=True)]
        for part in ("stem", "leaf")
    )
    false = [
        labels[v, u] > 0
        for labels, marks in zip(found.labels, points.values(), strict=True)
        for u, v in marks["background"]
    ]
    return {
        "romi_views": len(points),
        "romi_stem_covered": float(np.mean(stem)),
        "romi_leaves_covered": float(np.mean(leaf)),
        "romi_both_covered": float(np.mean(np.logical_and(stem, leaf))),
        "romi_background_masked": float(np.mean(false)),
        "romi_s_per_view": seconds / len(points),
    }


def overlaid(rgb: NDArray[Any], labels: NDArray[Any]) -> NDArray[Any]:
    """Return an image (H, W, 3) beside itself darkened, with plant in green and flowers in magenta."""
    out = rgb // 2
    for label, colour in ((PLANT, GREEN), (FLOWER, MAGENTA)):
        out[labels == label] = (0.4 * rgb[labels == label] + 0.6 * np.array(colour)).astype(np.uint8)
    return np.hstack([rgb, out])


def light_sheet(path: Path, shown: dict[Any, NDArray[Any]]) -> None:
    """Draw the pictures of each (species, light), all of a species in one row."""
    tiles = []
    for (species, light), pair in shown.items():
        left, right = np.hsplit(pair, 2)
        tile = cv2.resize(np.hstack([left[:, 240:1040], right[:, 240:1040]]), (340, 153), interpolation=cv2.INTER_AREA)
        cv2.putText(tile, f"{species}, {light}".replace("_", " "), (6, 14), 0, 0.42, (255, 255, 255), 1, cv2.LINE_AA)
        tiles.append(tile)
    columns = -(-len(tiles) // len({species for species, _ in shown}))  # a row for each species
    rows = [np.hstack(tiles[i : i + columns]) for i in range(0, len(tiles), columns)]
    path.parent.mkdir(parents=True, exist_ok=True)
    sheet = np.vstack(rows) // 16 * 16  # fewer colours, small enough for the documentation
    cv2.imwrite(str(path), sheet[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])


def report(rows: dict[tuple[Crop, str], dict[str, float]], values: dict[str, float]) -> Iterator[RenderableType]:
    """Yield the masks by light, those that bleed, and the real views."""
    quality = {
        "IoU": "*_iou:.3f",
        "IoU where depth is read": "*_iou_with_depth:.3f",
        "petal pixels: recall": "*_flower_recall:.0%",
        "precision": "*_flower_precision:.0%",
        "flowers found": "*_flowers_found:.0%",
        "pot or soil in the cloud": "*_pot_soil_in_cloud:.2%",
        "other things in it": "*_other_in_cloud:.2%",
        "s, CPU": "*_cpu_s:.1f",
    }
    lights = {f"{species}_{name}": f"{species}, {name.replace('_', ' ')}" for species, name in rows}
    yield by_part(values, "plant, light", lights, quality)
    bled = {"pot": "over all of pot and soil", "wide": "12 pixels too wide everywhere"}
    masked = {f"bleed_{kind}_{crop}": f"{crop}, {words}" for kind, words in bled.items() for crop in CROPS}
    freed = {
        "plant kept": "*_plant_kept:.1%",
        "pot or soil in the cloud": "*_pot_soil_in_cloud:.2%",
        "stem begins above soil, mm": "*_foot_mm:.0f",
    }
    yield "Masks that bleed as networks' do, freed of the ground:"
    yield by_part(values, "plant, mask", masked, freed)
    if "romi_views" in values:
        said = "stem romi_stem_covered:.0%, leaves romi_leaves_covered:.0%, background romi_background_masked:.0%."
        yield f"Real Arabidopsis, colour alone, {values['romi_views']} views: {written(said, values)}"


def main() -> None:
    """Run, print the table, write --json and --pictures."""
    own = {
        "--pictures": (Path, "write masks_light.png into this folder"),
        "--views": (30, "of each plant in each light"),
        "--lights": (tuple(SETTINGS), "only these", SETTINGS),
    }
    args = options(__doc__, quick=f"ten views, only {', '.join(QUICK)}", seed=(10, "of both plants"), own=own)
    lights, count = (QUICK, 10) if args.quick else (tuple(args.lights), args.views)
    plants = {species: grow(species, args.seed, 0.0, USUAL_DISTANCE) for species in CROPS}
    in_one_light(plants["tomato"], "daylight", 2)  # compiles
    rows, shown = {}, {}
    for case in progress([(species, name) for species in CROPS for name in lights], "lights"):
        rows[case], shown[case] = in_one_light(plants[case[0]], case[1], count)
    values = {f"{species}_{name}_{key}": v for (species, name), row in rows.items() for key, v in row.items()}
    values |= {f"{key}_min": min(row[key] for row in rows.values()) for key in ("iou", "iou_with_depth")}
    values["pot_soil_in_cloud_max"] = max(row["pot_soil_in_cloud"] for row in rows.values())
    for plant in progress(list(plants.values()), "bleeding masks"):
        values |= bleeding(plant, count)
    folder = DATA / "captures" / "romi_arabidopsis" / "images"
    values |= arabidopsis(folder) if folder.exists() else {}
    parts = [] if folder.exists() else [f"no real views: {folder} is missing (set ANTHER_DATA)"]
    finish(args, values, *parts, *report(rows, values))
    if args.pictures:
        light_sheet(args.pictures / "masks_light.png", shown)


def _surface_points(scene: Scene, count: int = 200_000) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return points spread evenly over everything near, and the organ of each."""
    near = scene.face_organ <= Organ.BENCH
    corner, organ = scene.vertices[scene.faces[near]], scene.face_organ[near]
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    rng = np.random.default_rng(0)
    face = rng.choice(len(area), count, p=area / area.sum())
    weight = rng.dirichlet(np.ones(3), count)
    return np.einsum("nk,nkx->nx", weight, corner[face]), organ[face]


def _ratio(part: NDArray[np.bool_], whole: NDArray[np.bool_]) -> float:
    return float(part.sum() / max(1, whole.sum()))


if __name__ == "__main__":
    main()

"""The frames of a shake show the plant that MuJoCo moves: one plant, seen and touched."""

from __future__ import annotations

import numpy as np
from grown_plants import grown
from straight_plant import BASE, straight_plant, with_blade

from anther.core.geometry import Intrinsics, look_at, transform_points
from anther.robot.devices import Frame
from anther.sim.cell import Cell
from anther.sim.plant import Organ
from anther.sim.render import Scene
from anther.sim.robot import SimCamera

CAMERA = Intrinsics(200, 160, 600.0, 600.0, 99.5, 79.5)


def test_a_leaf_in_the_frames_is_where_the_cell_has_it() -> None:
    leaf = np.add(BASE, [0.0, 0.05, 0.45])
    plant = with_blade(straight_plant(), leaf, [0.0, 1.0, 0.1], segment=17)
    cell = Cell(plant)
    pose = look_at(leaf - [0.0, 0.5, 0.0], leaf)
    camera = SimCamera(cell, Scene.of_plant(plant), CAMERA, lambda: pose, errors=None)
    cell.data.qpos[cell.model.jnt_qposadr[cell.mechanics.joints[:2]]] += 0.04
    cell.run(np.tile(cell.arm_command, (300, 1)), np.zeros((300, 7)), np.full(300, cell.grip_command))
    camera.start(30.0)
    cell.run(np.tile(cell.arm_command, (400, 1)), np.zeros((400, 7)), np.full(400, cell.grip_command))
    frames = camera.stop()
    log = cell.log()
    seen, true = [], []
    for frame in frames:
        points = CAMERA.back_project(frame.depth, (frame.depth > 0.3) & (frame.depth < 0.6))
        seen.append(transform_points(pose, points).mean(axis=0))
        sample = int(np.argmin(np.abs(log.times - frame.time)))
        true.append((cell.segment_poses(log.qpos[sample])[17] @ [*leaf, 1])[:3])
    assert len(frames) >= 12
    assert np.ptp(true, axis=0).max() > 0.005
    np.testing.assert_allclose(seen, true, atol=0.0012)  # a pixel is 0.8 mm wide


def test_a_frame_of_a_film_shows_what_a_whole_image_does() -> None:
    leaf = np.add(BASE, [0.0, 0.05, 0.45])
    plant = with_blade(straight_plant(), leaf, [0.0, 1.0, 0.1], segment=17)
    cell, scene = Cell(plant), Scene.of_plant(plant)
    pose = look_at(leaf - [0.0, 0.5, 0.0], leaf)
    camera = SimCamera(cell, scene, CAMERA, lambda: pose, errors=None)
    bent = np.zeros((3, *plant.vertices.shape))
    bent[1:, :, 0] = np.multiply.outer([0.002, 0.03], np.maximum(plant.vertices[:, 2] - BASE[2], 0.0))
    for shape in plant.vertices + bent:  # a little, and far beyond where the first still shows it
        image = scene.moved(shape).render(CAMERA, pose)
        frame = camera._frame(0.0, shape, None, np.random.default_rng(0), camera._still_of(shape))
        np.testing.assert_array_equal(frame.depth, image.depth)
        on_plant = image.organ < Organ.POT
        np.testing.assert_array_equal(frame.rgb[on_plant], image.rgb[on_plant])


def test_what_moves_while_a_frame_is_exposed_is_blurred_there_and_nothing_else() -> None:
    leaf = np.add(BASE, [0.0, 0.05, 0.45])
    plant = with_blade(straight_plant(), leaf, [0.0, 1.0, 0.1], segment=17)
    cell, pose = Cell(plant), look_at(leaf - [0.0, 0.5, 0.0], leaf)
    camera = SimCamera(cell, Scene.of_plant(plant), CAMERA, lambda: pose, errors=None)
    way = np.zeros(plant.vertices.shape)
    way[:, 0] = 0.1 * np.maximum(plant.vertices[:, 2] - leaf[2] - 0.01, 0)  # its top alone, by up to 2 px
    still = camera._still_of(plant.vertices)

    def frame() -> Frame:
        return camera._frame(0.0, plant.vertices, way, np.random.default_rng(0), still)

    here, sharp = frame(), camera._frame(0.0, plant.vertices, None, np.random.default_rng(0), still)
    blurred = camera._blurred(way, plant.vertices)
    assert 0.01 < blurred.mean() < 0.5
    camera._blurred = lambda *_: np.ones(blurred.shape, bool)  # type: ignore[method-assign]
    np.testing.assert_array_equal(here.rgb[blurred], frame().rgb[blurred])
    np.testing.assert_array_equal(here.rgb[~blurred], sharp.rgb[~blurred])
    assert np.abs(here.rgb[blurred].astype(float) - sharp.rgb[blurred]).mean() > 1


def test_a_pixel_of_a_flower_gathers_light_from_its_area() -> None:
    plant = grown("tomato", 3, axis=(0.72, 0.0))
    cell, scene, flower = Cell(plant), Scene.of_plant(plant), plant.flower_position[0]
    pose = look_at(flower - [0.0, 0.4, 0.0], flower)
    frame = SimCamera(cell, scene, CAMERA, lambda: pose, errors=None).read()
    fine = scene.render(Intrinsics(1600, 1280, 4800.0, 4800.0, 799.5, 639.5), pose)  # 64 rays a pixel
    true = fine.rgb.reshape(160, 8, 200, 8, 3).mean(axis=(1, 3))
    one = scene.render(CAMERA, pose)
    at = one.organ == Organ.FLOWER
    assert at.sum() > 100
    assert np.abs(frame.rgb[at] - true[at]).mean() < 0.8 * np.abs(one.rgb[at] - true[at]).mean()

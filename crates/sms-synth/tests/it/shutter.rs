//! Colour of a moving camera against closed forms.

use glamx::{DVec2, DVec3};
use sms_core::{Aabb, Camera, ColorImage, Intrinsics, Seed};
use sms_synth::{
    AssetBlueprint, CameraModel, ColorCamera, FrameState, Pattern, RenderedFrame, Renderer, Texture,
    TruthScene, cuboid_union, draw_floor,
};

/// Distance of the walls from the camera, metres.
const Z_M: f64 = 0.3;
const FOCAL_PX: f64 = 300.0;
/// Speed of the camera along its own x, m/s.
const SPEED: f64 = 0.12;

/// Two walls in one plane, a white one in the left half of the view of [`camera`] and a black one in the right half.
fn scene() -> TruthScene {
    let mut rng = Seed(1).rng();
    let mut wall = |level: u8, x: f64| {
        let solid = Aabb { min: DVec3::new(-0.25, -0.02, 0.0), max: DVec3::new(0.25, 0.02, 0.3) };
        let texture = Texture::drawn(&mut rng, Pattern::Plain, ([level; 3], [level; 3]), 10.0, 0.0);
        let blueprint = AssetBlueprint::new("wall", "wall", "wood", cuboid_union(&[solid], 1.0), texture);
        blueprint.place(DVec2::new(x, 0.0), 0.0, &mut rng)
    };
    let mut objects = vec![wall(235, 0.25), wall(5, -0.25)];
    sms_synth::name_uniquely(&mut objects);
    TruthScene::of_objects("walls".into(), Seed(1), objects, draw_floor(Seed(1), Seed(1)))
}

/// Looks along −y at the edge between the walls.
fn camera() -> Camera {
    let edge = DVec3::new(0.0, 0.02, 0.15);
    let k = Intrinsics { width: 320, height: 200, fx: FOCAL_PX, fy: FOCAL_PX, cx: 160.0, cy: 100.0 };
    Camera::look_at(k, edge + DVec3::Y * Z_M, edge, DVec3::Z)
}

fn taken(color: ColorCamera) -> RenderedFrame {
    let scene = scene();
    let camera = camera();
    let velocity_w_m_s = camera.x_wc.rotation * DVec3::X * SPEED;
    let state = FrameState { velocity_w_m_s, ..FrameState::default() };
    let model = CameraModel { color, ..CameraModel::perfect() };
    Renderer::new(&scene).render_moving(&camera, &model, &state)
}

fn level(color: &ColorImage, x: usize, y: usize) -> f64 {
    color[(x, y)].iter().map(|&c| f64::from(c)).sum::<f64>() / 3.0
}

/// Returns the place in a row where the level falls to this share of the way from black to white.
fn falls_at(color: &ColorImage, y: usize, share: f64) -> f64 {
    let (white, black) = (level(color, 80, y), level(color, 240, y));
    assert!(white > black + 60.0, "the walls differ: {white} {black}");
    let limit = black + share * (white - black);
    let x = (80..240).find(|&x| level(color, x, y) < limit).unwrap();
    let (before, after) = (level(color, x - 1, y), level(color, x, y));
    x as f64 - 0.5 + (before - limit) / (before - after)
}

#[test]
fn a_rolling_shutter_shears_a_vertical_edge_by_speed_and_time() {
    let still = taken(ColorCamera::perfect());
    let rolling = taken(ColorCamera { readout_s: 0.1, ..ColorCamera::perfect() });
    assert_eq!((&rolling.depth, &rolling.label), (&still.depth, &still.label), "depth has no readout");
    for y in [5, 60, 100, 190] {
        assert!((falls_at(&still.color, y, 0.5) - 160.0).abs() < 0.6);
        let time_s = 0.1 * ((y as f64 + 0.5) / 200.0 - 0.5);
        let expected = 160.0 - FOCAL_PX * SPEED * time_s / Z_M;
        let found = falls_at(&rolling.color, y, 0.5);
        assert!((found - expected).abs() < 0.6, "row {y}: {found} {expected}");
    }
}

#[test]
fn motion_blur_widens_an_edge_by_the_way_of_the_image() {
    let width = |exposure_s: f64| {
        let color = taken(ColorCamera { exposure_s, ..ColorCamera::perfect() }).color;
        (20..180).map(|y| falls_at(&color, y, 0.02) - falls_at(&color, y, 0.98)).sum::<f64>() / 160.0
    };
    let sharp = width(0.0);
    assert!(sharp < 2.5, "{sharp}");
    for blur_px in [6.0, 12.0] {
        let found = width(blur_px * Z_M / (FOCAL_PX * SPEED));
        assert!((found - blur_px).abs() < 1.5, "{found} {blur_px}");
    }
}

#[test]
fn colour_is_shifted_by_its_offset_and_by_its_delay() {
    // A quarter of 1280 wide: 16 pixels are 4.
    let moved = taken(ColorCamera { offset_px: [16.0, 0.0], ..ColorCamera::perfect() });
    assert!((falls_at(&moved.color, 100, 0.5) - 164.0).abs() < 0.6);
    let late = taken(ColorCamera { delay_s: 0.05, ..ColorCamera::perfect() });
    assert!((falls_at(&late.color, 100, 0.5) - (160.0 - FOCAL_PX * SPEED * 0.05 / Z_M)).abs() < 0.6);
    assert_eq!(late.depth, moved.depth);
}

#[test]
fn gain_changes_brightness_and_neither_edges_nor_depth() {
    let scene = scene();
    let take = |gain: f64| {
        let state = FrameState { gain, ..FrameState::default() };
        Renderer::new(&scene).render_moving(&camera(), &CameraModel::perfect(), &state)
    };
    let (usual, dark) = (take(1.0), take(0.5));
    assert_eq!(usual, Renderer::new(&scene).render(&camera(), &CameraModel::perfect()));
    assert!(level(&dark.color, 80, 100) < 0.9 * level(&usual.color, 80, 100));
    assert_eq!(usual.depth_noisy, dark.depth_noisy);
}

#[test]
fn a_moving_frame_does_not_depend_on_threads() {
    let color =
        ColorCamera { exposure_s: 0.03, readout_s: 0.02, offset_px: [3.0, 1.0], ..ColorCamera::default() };
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| taken(color.clone()))
    };
    assert_eq!(with(1), with(3));
}

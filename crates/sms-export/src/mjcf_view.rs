//! Appearance of an MJCF scene in MuJoCo's viewer: the floor's material and the first view.

use crate::text::{number, numbers};
use glamx::DVec3;
use sms_core::Aabb;
use sms_scene::{BodyKind, Scene};

/// Distance between the lines of a plane that is drawn as a grid, metres.
pub(crate) const FLOOR_GRID: f64 = 0.1;
/// Squares of the checkerboard per metre. MuJoCo repeats a texture half as often per metre as `texrepeat` says: measured
/// with 3.3 and 4.0, the squares of a texture of two squares are 0.1 m wide.
const CHECKERS_PER_M: f64 = 10.0;
/// Vertical angle of the free camera, radians: MuJoCo's default of 45°.
const VIEW_ANGLE: f64 = std::f64::consts::FRAC_PI_4;
/// Distance of the free camera from the centre when MuJoCo opens a model, as a multiple of the extent.
const DISTANCE_PER_EXTENT: f64 = 1.5;
/// Brightness of the dark squares relative to the light ones: enough to see the pattern beside textured objects.
const DARK_SQUARES: f64 = 0.85;

/// Returns the assets of the floor `name`, with the material `{name}_look`: a checkerboard in its mean sRGB colour, which
/// shows scale and shadows.
pub(crate) fn floor_material(name: &str, color: [u8; 3]) -> String {
    let light = color.map(|c| f64::from(c) / 255.0);
    let rounded = |share: f64| numbers(light.map(|c| (1e4 * share * c).round() / 1e4));
    let (rgb1, rgb2) = (rounded(1.0), rounded(DARK_SQUARES));
    let repeat = numbers([CHECKERS_PER_M; 2]);
    format!(
        r#"    <texture name="{name}_checker" type="2d" builtin="checker" rgb1="{rgb1}" rgb2="{rgb2}" width="256" height="256"/>
    <material name="{name}_look" texture="{name}_checker" texuniform="true" texrepeat="{repeat}" specular="0"/>
"#
    )
}

/// Returns the element that sets centre and size of the first view: the moving bodies, not the slab of the floor.
/// Empty for a scene without bodies of finite size.
pub(crate) fn statistic(scene: &Scene) -> String {
    let corners = |only_moving: bool| {
        let shown = scene.bodies.iter().filter(move |b| !only_moving || b.kind == BodyKind::Dynamic);
        Aabb::of_points(shown.filter_map(|b| b.aabb_w()).flat_map(|b| [b.min, b.max]))
    };
    let Some(around) = corners(true).or_else(|| corners(false)) else { return String::new() };
    let millimetres = |p: DVec3| (1e3 * p).round() / 1e3;
    // The sphere around the bodies fills the height of the view.
    let radius = 0.5 * around.extents().length();
    let distance = radius / (0.5 * VIEW_ANGLE).sin();
    let extent = (1e3 * distance / DISTANCE_PER_EXTENT).ceil() / 1e3;
    format!(
        "  <statistic center=\"{}\" extent=\"{}\"/>\n",
        numbers(millimetres(around.center()).to_array()),
        number(extent)
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::example::scene;

    #[test]
    fn the_first_view_is_around_the_moving_bodies() {
        let mut scene = scene();
        let numbers_of = |text: &str, key: &str| -> Vec<f64> {
            let value = text.split(&format!("{key}=\"")).nth(1).unwrap().split('"').next().unwrap();
            value.split(' ').map(|v| v.parse().unwrap()).collect()
        };
        let text = statistic(&scene);
        let (center, extent) = (numbers_of(&text, "center"), numbers_of(&text, "extent")[0]);
        for body in scene.bodies.iter().filter(|b| b.kind == BodyKind::Dynamic) {
            let far = body.x_wb.translation.distance(DVec3::new(center[0], center[1], center[2]));
            let seen = 1.5 * extent * (22.5_f64).to_radians().sin();
            assert!(far <= seen, "{}: {far} of {seen}", body.name);
        }
        assert!(extent < 1.0, "the floor and static bodies 1 m away do not count: {extent}");
        scene.bodies.truncate(1);
        assert_eq!(statistic(&scene), "");
    }
}

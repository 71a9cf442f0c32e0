//! The renderer against closed forms and brute force; the camera path.

use glamx::DVec3;
use rand::RngExt;
use sms_core::{Camera, Seed};
use sms_synth::{
    AssetKind, BilliardsSettings, CameraModel, CameraPath, RecordingSettings, RenderedFrame, Renderer,
    TruthScene, generate_billiards,
};

fn render(scene: &TruthScene, camera: &Camera, model: &CameraModel) -> RenderedFrame {
    Renderer::new(scene).render(camera, model)
}

fn perfect() -> CameraModel {
    CameraModel::perfect()
}

fn scene() -> TruthScene {
    use AssetKind::{Bowl, CardboardBox, Mug, SoccerBall, ToyDuck};
    let kinds = vec![Bowl, CardboardBox, Mug, SoccerBall, ToyDuck];
    generate_billiards(Seed(2), &BilliardsSettings { kinds, ..BilliardsSettings::default() })
}

fn cameras(scene: &TruthScene) -> Vec<Camera> {
    let k = RecordingSettings { width: 320, height: 200, ..RecordingSettings::default() }.intrinsics();
    let poses = CameraPath::default().poses(scene, 60);
    [0, 13, 37, 59].map(|i| Camera::new(k, poses[i])).to_vec()
}

/// Depth and label along a pixel's ray in f64, testing every sphere and triangle.
fn brute_force(scene: &TruthScene, camera: &Camera, x: usize, y: usize) -> (f64, u16) {
    let eye = camera.center_w();
    let d = camera.unproject_pixel(x, y, 1.0) - eye;
    let mut best = (f64::INFINITY, 0);
    let floor = eye.z / -d.z;
    let p = eye + d * floor;
    if floor > 0.0 && p.x.abs() <= scene.floor.half_size_m && p.y.abs() <= scene.floor.half_size_m {
        best.0 = floor;
    }
    for (index, object) in scene.objects.iter().enumerate() {
        let label = index as u16 + 1;
        if let Some(r) = object.sphere_radius {
            let f = eye - object.x_wb.translation;
            let (a, b, c) = (d.length_squared(), f.dot(d), f.length_squared() - r * r);
            let root = b * b - a * c;
            if root >= 0.0 {
                let t = (-b - root.sqrt()) / a;
                if t > 0.0 && t < best.0 {
                    best = (t, label);
                }
            }
            continue;
        }
        let mesh = object.mesh_w();
        for t in 0..mesh.triangles.len() {
            let [a, b, c] = mesh.corners(t);
            let n = (b - a).cross(c - a);
            let along = (a - eye).dot(n) / d.dot(n);
            let p = eye + d * along;
            let inside = [(a, b), (b, c), (c, a)].iter().all(|&(u, v)| (v - u).cross(p - u).dot(n) >= 0.0);
            if inside && along > 0.0 && along < best.0 {
                best = (along, label);
            }
        }
    }
    if best.0.is_finite() { best } else { (0.0, 0) }
}

#[test]
fn depth_and_labels_are_those_of_the_nearest_surface() {
    let scene = scene();
    let renderer = Renderer::new(&scene);
    let mut rng = Seed(5).rng();
    let (mut checked, mut on_objects, mut outlines) = (0, 0, 0);
    for camera in cameras(&scene) {
        let frame = renderer.render(&camera, &perfect());
        assert_eq!(frame.depth, frame.depth_noisy);
        while checked % 500 < 499 {
            checked += 1;
            let (x, y) = (rng.random_range(0..320), rng.random_range(0..200));
            // Half of the samples on objects, which fill a tenth of the image.
            if checked % 2 == 0 && frame.label[(x, y)] == 0 {
                continue;
            }
            let (z, label) = brute_force(&scene, &camera, x, y);
            let found = (f64::from(frame.depth[(x, y)]), frame.label[(x, y)]);
            if found.1 != label {
                // Rounding may decide only for rays that graze an outline.
                outlines += 1;
                continue;
            }
            on_objects += usize::from(label > 0);
            assert!((found.0 - z).abs() < 3e-5, "({x}, {y}): {found:?} instead of {:?}", (z, label));
        }
        checked += 1;
    }
    assert!(on_objects > 100, "{on_objects}");
    assert!(outlines <= 1, "{outlines} labels are wrong");
}

#[test]
fn spheres_and_floor_have_their_closed_form_depth() {
    let scene = scene();
    let cue = scene.object(&scene.cue).unwrap();
    let (center, r) = (cue.x_wb.translation, cue.sphere_radius.unwrap());
    let (mut ball, mut floor) = (0, 0);
    let renderer = Renderer::new(&scene);
    for camera in cameras(&scene) {
        let frame = renderer.render(&camera, &perfect());
        for y in 0..200 {
            for x in 0..320 {
                let z = f64::from(frame.depth[(x, y)]);
                let p = camera.unproject_pixel(x, y, z);
                match frame.label[(x, y)] {
                    1 => {
                        let off = ((p - center).length() - r).abs();
                        // A grazing ray turns rounding of the ray into depth along it.
                        let cos = (p - center).normalize().dot((camera.center_w() - p).normalize());
                        assert!(off < 2e-6 && cos > 0.0, "{off}");
                        ball += 1;
                    }
                    0 if z > 0.0 => {
                        assert!(p.z.abs() < 2e-6, "{}", p.z);
                        floor += 1;
                    }
                    _ => {}
                }
            }
        }
    }
    assert!(ball > 300 && floor > 50_000, "{ball} {floor}");
}

#[test]
fn colour_shows_the_balls_light_and_shadow() {
    let scene = scene();
    let ball = scene.object(&scene.cue).unwrap().x_wb.translation;
    // From above, where the ball does not hide its shadow.
    let k = cameras(&scene)[0].intrinsics;
    let camera = Camera::look_at(k, ball + DVec3::new(-0.1, 0.0, 0.7), ball + DVec3::X * 0.1, DVec3::Z);
    let frame = render(&scene, &camera, &perfect());
    let mean = |label: u16| {
        let pixels: Vec<[u8; 3]> = (0..320 * 200)
            .filter(|&i| frame.label.data[i] == label && frame.depth.data[i] > 0.0)
            .map(|i| frame.color.data[i])
            .collect();
        [0, 1, 2].map(|c| pixels.iter().map(|p| f64::from(p[c])).sum::<f64>() / pixels.len() as f64)
    };
    let (cue, target) = (mean(1), mean(2));
    assert!(cue.iter().all(|&c| c > 130.0) && cue[0] - cue[2] < 40.0, "the cue ball is white: {cue:?}");
    assert!(target[2] > 2.0 * target[0] && target[2] > 90.0, "the target ball is blue: {target:?}");
    // The floor beside the cue ball, away from the key light, is darker than the floor far from it.
    let luminance = |p: DVec3| {
        let (u, v, _) = camera.project(p).unwrap();
        let (x, y) = camera.pixel_at(u, v).unwrap();
        assert_eq!(frame.label[(x, y)], 0, "the probe is on the floor");
        frame.color[(x, y)].iter().map(|&c| f64::from(c)).sum::<f64>()
    };
    let away = DVec3::new(0.55, 0.83, 0.0);
    let shadow = luminance((ball + away * 0.045).with_z(0.0));
    let lit = luminance((ball - away * 0.09).with_z(0.0));
    assert!(shadow < 0.85 * lit, "{shadow} {lit}");
}

#[test]
fn a_frame_does_not_depend_on_threads_and_its_noise_depends_on_the_seed() {
    let scene = scene();
    let camera = cameras(&scene)[1];
    let with = |threads: usize, seed: u64| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let model = CameraModel { seed: Seed(seed), ..CameraModel::default() };
        pool.install(|| render(&scene, &camera, &model))
    };
    let one = with(1, 7);
    assert_eq!(one, with(2, 7));
    let other = with(2, 8);
    assert_eq!((&one.depth, &one.label), (&other.depth, &other.label));
    assert_ne!(one.depth_noisy, other.depth_noisy);
    assert_ne!(one.color, other.color);
    // Most pixels in range have an accurate measurement.
    let mut errors: Vec<f32> = Vec::new();
    let mut lost = 0;
    for (&z, &m) in one.depth.data.iter().zip(&one.depth_noisy.data) {
        if z > 0.0 && z < 2.0 {
            if m > 0.0 { errors.push((m - z).abs() / (0.0004 + 0.0012 * z * z)) } else { lost += 1 }
        }
    }
    errors.sort_by(f32::total_cmp);
    let median = errors[errors.len() / 2];
    assert!((median - 0.674).abs() < 0.06, "the median of |N(0, 1)| is 0.674, found {median}");
    assert!(lost * 5 < errors.len(), "{lost} of {} lost", errors.len());
}

#[test]
fn the_path_is_the_paper_s() {
    let scene = scene();
    for path in [CameraPath::default(), CameraPath::paper()] {
        let poses = path.poses(&scene, 60);
        let mut azimuths = Vec::new();
        for (i, x_wc) in poses.iter().enumerate() {
            let eye = x_wc.translation;
            assert!((eye - scene.robot_base_w).length() <= path.sphere_radius_m + 1e-9);
            let on_sphere = ((eye - scene.robot_base_w).length() - path.sphere_radius_m).abs() < 1e-9;
            let on_plane = (eye.x - path.plane_x_m).abs() < 1e-9;
            assert!(on_sphere || on_plane, "frame {i} is neither on the sphere nor on the plane");
            let to_center = (scene.workspace_center_w - eye).normalize();
            assert!(
                (x_wc.rotation * DVec3::Z).dot(to_center) > 1.0 - 1e-12,
                "it looks at the workspace's centre"
            );
            assert!((x_wc.rotation * DVec3::Y).z < 0.0, "the image's down is down");
            assert!((x_wc.rotation * DVec3::X).z.abs() < 1e-12, "the horizon is level");
            let [low, high] = path.height_range_m;
            assert!((low - 1e-9..=high + 1e-9).contains(&eye.z));
            assert!(i == 0 || eye.z > poses[i - 1].translation.z, "the height rises");
            let from_center = eye - scene.workspace_center_w;
            azimuths.push(from_center.y.atan2(from_center.x).to_degrees());
        }
        // It starts in the middle of the plane at the robot, and sees the workspace from all around.
        assert!(
            poses[0].translation.y.abs() < 1e-9 && (poses[0].translation.x - path.plane_x_m).abs() < 1e-9
        );
        azimuths.sort_by(f64::total_cmp);
        let wrap = azimuths[0] + 360.0 - azimuths[azimuths.len() - 1];
        let widest = azimuths.windows(2).map(|w| w[1] - w[0]).fold(wrap, f64::max);
        assert!(widest < 20.0, "a gap of {widest}°");
    }
    assert_eq!(CameraPath::default().poses(&scene, 1).len(), 1);
    assert!(CameraPath::default().poses(&scene, 0).is_empty());
}

#[test]
fn the_path_sees_every_ball_top_and_most_of_every_object() {
    let scene = scene();
    let k = RecordingSettings { width: 160, height: 100, ..RecordingSettings::default() }.intrinsics();
    let mut pixels = vec![0usize; scene.objects.len() + 1];
    let mut tops = vec![0usize; scene.objects.len()];
    let mut frames_with = vec![0usize; scene.objects.len()];
    let renderer = Renderer::new(&scene);
    for x_wc in CameraPath::default().poses(&scene, 30) {
        let camera = Camera::new(k, x_wc);
        let frame = renderer.render(&camera, &perfect());
        for i in 1..pixels.len() {
            let seen = frame.label.data.iter().filter(|&&l| l as usize == i).count();
            pixels[i] += seen;
            frames_with[i - 1] += usize::from(seen > 8);
        }
        for (i, o) in scene.objects.iter().enumerate() {
            let Some(r) = o.sphere_radius else { continue };
            let top = o.x_wb.translation + DVec3::Z * (r - 1e-4);
            if let Some((u, v, z)) = camera.project(top)
                && let Some(p) = camera.pixel_at(u, v)
            {
                tops[i] += usize::from((f64::from(frame.depth[p]) - z).abs() < 0.01);
            }
        }
    }
    assert!(frames_with.iter().all(|&n| n >= 15), "frames with each object: {frames_with:?}");
    for (o, &n) in scene.objects.iter().zip(&tops) {
        assert!(o.sphere_radius.is_none() || n >= 8, "the top of {} is seen {n} times", o.name);
    }
}

#[test]
fn depth_and_labels_know_nothing_of_looks() {
    let scene = scene();
    let mut other = scene.clone();
    other.floor.texture.gloss = 0.9;
    for (i, object) in other.objects.iter_mut().enumerate() {
        object.texture.gloss = 0.15 * i as f32;
        object.texture.metalness = 1.0;
        object.texture.color = [255 - object.texture.color[0], 20, 200];
        object.texture.spots.clear();
    }
    let camera = &cameras(&scene)[2];
    let (a, b) = (render(&scene, camera, &perfect()), render(&other, camera, &perfect()));
    assert_eq!((&a.depth, &a.label), (&b.depth, &b.label));
    assert_eq!(a.depth, a.depth_noisy, "a perfect camera sees dark and glaring surfaces too");
    assert_ne!(a.color, b.color);
}

#[test]
fn balls_have_the_colours_that_tasks_name() {
    // Chromaticity and lightness in 8-bit sRGB on every floor: white is bright and without a tint, blue is blue.
    for seed in 1..=3 {
        let scene = generate_billiards(Seed(seed), &BilliardsSettings::default());
        let renderer = Renderer::new(&scene);
        let mut sums = [[0.0; 4]; 2];
        for camera in cameras(&scene) {
            let frame = renderer.render(&camera, &perfect());
            for (color, label) in frame.color.data.iter().zip(&frame.label.data) {
                if let Some(sum) = sums.get_mut((*label as usize).wrapping_sub(1)) {
                    (0..3).for_each(|c| sum[c] += f64::from(color[c]));
                    sum[3] += 1.0;
                }
            }
        }
        let [white, blue] = sums.map(|s| [s[0] / s[3], s[1] / s[3], s[2] / s[3]]);
        assert!(white.iter().all(|&c| c > 165.0) && (white[0] - white[2]).abs() < 30.0, "{seed}: {white:?}");
        assert!(blue[2] > 120.0 && blue[2] > 1.6 * blue[0].max(blue[1]), "{seed}: {blue:?}");
    }
}

//! Resampling and normals against closed forms.

use glamx::DVec3;
use rand::RngExt;
use sms_core::{Camera, DepthImage, Image, Intrinsics, Seed};
use sms_frames::{
    DepthNoise, Distortion, Lens, normals_from_depth, resample_depth, resize_color, target_intrinsics,
    undistort_color,
};

fn pinhole(k: Intrinsics) -> Lens {
    Lens { intrinsics: k, distortion: Distortion::default() }
}

/// Normally distributed by twelve uniform draws (variance 1; tails end at 6σ).
fn gauss(rng: &mut sms_core::StageRng) -> f64 {
    (0..12).map(|_| rng.random_range(0.0..1.0)).sum::<f64>() - 6.0
}

/// Depth of the plane n·p = d (camera frame) at the pixel centres.
fn plane_depth(k: &Intrinsics, n: DVec3, d: f64) -> DepthImage {
    let pixel = |i: usize| {
        let (x, y) = ((i % k.width) as f64 + 0.5, (i / k.width) as f64 + 0.5);
        (d / n.dot(DVec3::new((x - k.cx) / k.fx, (y - k.cy) / k.fy, 1.0))) as f32
    };
    Image::from_vec(k.width, k.height, (0..k.width * k.height).map(pixel).collect())
}

fn angles(normals: &sms_core::NormalImage, truth: DVec3) -> Vec<f64> {
    let mut angles: Vec<f64> = normals
        .data
        .iter()
        .filter(|n| **n != [0.0; 3])
        .map(|n| DVec3::new(n[0].into(), n[1].into(), n[2].into()).angle_between(truth).to_degrees())
        .collect();
    angles.sort_by(f64::total_cmp);
    angles
}

#[test]
fn normals_of_a_plane_are_exact_without_noise_and_face_the_camera() {
    let k = Intrinsics { width: 80, height: 60, fx: 90.0, fy: 91.0, cx: 38.2, cy: 31.0 };
    for n in [DVec3::new(0.3, -0.5, 0.7), DVec3::new(0.0, 0.9, 0.4), DVec3::Z] {
        let n = n.normalize();
        let depth = plane_depth(&k, n, 0.4);
        let valid = depth.map(|&z| if z > 0.0 && z < 3.0 { z } else { 0.0 });
        let angles = angles(&normals_from_depth(&valid, &k, &DepthNoise::default(), 2), -n);
        assert!(angles.len() > 500 && *angles.last().unwrap() < 0.05, "{} {:?}", angles.len(), angles.last());
    }
}

#[test]
fn one_millimetre_of_noise_tilts_normals_as_least_squares_predicts() {
    // 2 mm pitch at 0.6 m, as in the real recordings at scan resolution.
    let k = Intrinsics { width: 160, height: 120, fx: 300.0, fy: 300.0, cx: 80.0, cy: 60.0 };
    let mut rng = Seed(3).rng();
    let depth = plane_depth(&k, DVec3::Z, 0.6).map(|&z| z + (1e-3 * gauss(&mut rng)) as f32);
    let full = angles(&normals_from_depth(&depth, &k, &DepthNoise::default(), 2), -DVec3::Z);
    let median = full[full.len() / 2];
    // Unweighted 5 × 5: σ/(pitch √Σx²) = 1/(2 √50) rad a direction, median of the two together 1.18 times that: 4.8°.
    println!("median tilt {median:.2}°");
    assert!((4.0..6.5).contains(&median), "{median}");
    // With two thirds of the pixels missing at random few windows are too empty, and the tilt grows.
    let sparse = depth.map(|&z| if rng.random_range(0.0..1.0) < 0.36 { z } else { 0.0 });
    let normals = normals_from_depth(&sparse, &k, &DepthNoise::default(), 2);
    let some = angles(&normals, -DVec3::Z);
    let valid = sparse.data.iter().filter(|&&z| z > 0.0).count();
    assert!(some.len() as f64 > 0.85 * valid as f64);
    println!("sparse: median tilt {:.2}°, {} of {valid}", some[some.len() / 2], some.len());
    assert!(some[some.len() / 2] < 12.0);
}

#[test]
fn a_step_in_depth_does_not_tilt_the_normals_beside_it() {
    let k = Intrinsics { width: 40, height: 40, fx: 100.0, fy: 100.0, cx: 20.0, cy: 20.0 };
    let mut depth = Image::filled(40, 40, 0.5f32);
    for y in 0..40 {
        (20..40).for_each(|x| depth[(x, y)] = 0.62);
    }
    let angles = angles(&normals_from_depth(&depth, &k, &DepthNoise::default(), 2), -DVec3::Z);
    assert_eq!(angles.len(), 1600);
    assert!(*angles.last().unwrap() < 0.1, "{:?}", angles.last());
}

#[test]
fn too_few_or_collinear_pixels_have_no_normal() {
    let k = Intrinsics { width: 20, height: 20, fx: 30.0, fy: 30.0, cx: 10.0, cy: 10.0 };
    let mut depth = Image::filled(20, 20, 0.0f32);
    (0..20).for_each(|x| depth[(x, 10)] = 0.5);
    let noise = DepthNoise::default();
    assert!(normals_from_depth(&depth, &k, &noise, 4).data.iter().all(|n| *n == [0.0; 3]));
    for (x, y) in [(4, 4), (5, 4), (4, 5), (5, 5), (6, 5)] {
        depth[(x, y)] = 0.5;
    }
    assert_eq!(normals_from_depth(&depth, &k, &noise, 2)[(5, 5)], [0.0; 3], "five pixels are too few");
    depth[(6, 4)] = 0.5;
    assert!(normals_from_depth(&depth, &k, &noise, 2)[(5, 5)][2] < -0.99, "six are enough");
}

#[test]
fn shrinking_depth_keeps_a_slanted_plane_where_it_is() {
    let k = Intrinsics { width: 160, height: 120, fx: 200.0, fy: 200.0, cx: 80.0, cy: 60.0 };
    let lens = pinhole(k);
    let noise = DepthNoise::default();
    let n = DVec3::new(0.5, 0.4, 0.7).normalize();
    let mut rng = Seed(1).rng();
    for (long, keep) in [(80, 1.0), (40, 1.0), (80, 0.4), (100, 0.5)] {
        let target = target_intrinsics(&lens, long);
        let depth = plane_depth(&k, n, 0.45);
        let depth = depth.map(|&z| if rng.random_range(0.0..1.0) < keep { z } else { 0.0 });
        let small = resample_depth(&depth, &lens, &target, &noise);
        let truth = plane_depth(&target, n, 0.45);
        let mut errors: Vec<f32> = small
            .data
            .iter()
            .zip(&truth.data)
            .filter(|(z, _)| **z > 0.0)
            .map(|(z, t)| (z - t).abs())
            .collect();
        errors.sort_by(f32::total_cmp);
        let slope = 0.001 * 160.0 / long as f32;
        println!(
            "{long}: median {:.1e}, p99 {:.1e}",
            errors[errors.len() / 2],
            errors[errors.len() * 99 / 100]
        );
        assert!(errors[errors.len() / 2] < 1e-5, "exact where the plane can be seen");
        assert!(errors[errors.len() * 99 / 100] < 0.5 * slope);
    }
}

#[test]
fn shrinking_averages_noise_and_fills_holes() {
    let k = Intrinsics { width: 320, height: 240, fx: 400.0, fy: 400.0, cx: 160.0, cy: 120.0 };
    let lens = pinhole(k);
    let target = target_intrinsics(&lens, 80);
    let mut rng = Seed(2).rng();
    let depth = plane_depth(&k, DVec3::new(0.0, 0.3, 1.0).normalize(), 0.6)
        .map(|&z| if rng.random_range(0.0..1.0) < 0.36 { z + (1e-3 * gauss(&mut rng)) as f32 } else { 0.0 });
    let small = resample_depth(&depth, &lens, &target, &DepthNoise::default());
    let truth = plane_depth(&target, DVec3::new(0.0, 0.3, 1.0).normalize(), 0.6);
    let valid: Vec<f64> = small
        .data
        .iter()
        .zip(&truth.data)
        .filter(|(z, _)| **z > 0.0)
        .map(|(z, t)| f64::from(z - t))
        .collect();
    let rms = (valid.iter().map(|e| e * e).sum::<f64>() / valid.len() as f64).sqrt();
    println!("fill {:.3}, rms {:.2} mm", valid.len() as f64 / 4800.0, 1e3 * rms);
    assert!(valid.len() > 4700);
    // 16 × 0.36 samples a block would average to 0.42 mm.
    assert!(rms < 0.6e-3, "{rms}");
}

#[test]
fn the_front_surface_wins_and_a_stray_value_does_not() {
    let k = Intrinsics { width: 80, height: 80, fx: 100.0, fy: 100.0, cx: 40.0, cy: 40.0 };
    let lens = pinhole(k);
    let target = target_intrinsics(&lens, 20);
    let mut depth = Image::filled(80, 80, 1.0f32);
    // The left two columns of every block are near; one stray pixel hangs in front of the lower blocks.
    for y in 0..80 {
        for x in 0..80 {
            if y < 40 && x % 4 < 2 {
                depth[(x, y)] = 0.5;
            }
            if y >= 40 && (x % 4, y % 4) == (1, 1) {
                depth[(x, y)] = 0.2;
            }
        }
    }
    let small = resample_depth(&depth, &lens, &target, &DepthNoise::default());
    for y in 0..20 {
        for x in 0..20 {
            let expected = if y < 10 { 0.5 } else { 1.0 };
            assert!((small[(x, y)] - expected).abs() < 1e-6, "{x} {y}: {}", small[(x, y)]);
        }
    }
}

#[test]
fn depth_smaller_than_the_target_is_taken_by_nearest_neighbour() {
    let k = Intrinsics { width: 64, height: 48, fx: 80.0, fy: 80.0, cx: 32.0, cy: 24.0 };
    let lens = pinhole(k.scaled_to(16, 12));
    let depth = Image::from_vec(16, 12, (0..192).map(|i| 0.5 + i as f32).collect());
    let large = resample_depth(&depth, &lens, &k, &DepthNoise::default());
    for y in 0..48 {
        for x in 0..64 {
            assert_eq!(large[(x, y)], depth[(x / 4, y / 4)]);
        }
    }
}

#[test]
fn colour_keeps_constants_and_ramps_and_does_not_alias() {
    let flat = Image::filled(64, 40, [10u8, 128, 255]);
    assert!(resize_color(&flat, 23, 17).data.iter().all(|p| *p == [10, 128, 255]));
    let ramp = Image::from_vec(64, 8, (0..512).map(|i| [(3 * (i % 64)) as u8 + 20, 0, 0]).collect());
    let half = resize_color(&ramp, 32, 4);
    for x in 4..28 {
        // The centre of pixel x lies between the source pixels 2x and 2x + 1.
        let expected = 20.0 + 3.0 * (2.0 * x as f64 + 0.5);
        assert!((f64::from(half[(x, 2)][0]) - expected).abs() <= 1.0);
    }
    let stripes = Image::from_vec(240, 8, (0..1920).map(|i| [if i % 2 == 0 { 0 } else { 200 }; 3]).collect());
    for pixel in &resize_color(&stripes, 67, 8).data[4..60] {
        assert!((95..=105).contains(&pixel[0]), "stripes finer than the target are grey: {pixel:?}");
    }
}

#[test]
fn colour_ramps_scale_in_both_directions() {
    let pixel = |i: usize| {
        let (x, y) = (i % 40, i / 40);
        [(40 + 3 * x) as u8, (200 - 4 * y) as u8, (90 + x + y) as u8]
    };
    let picture = Image::from_vec(40, 30, (0..40 * 30).map(pixel).collect());
    assert_eq!(resize_color(&picture, 40, 30), picture);
    let half = resize_color(&picture, 20, 15);
    for y in 1..14 {
        for x in 1..19 {
            // The centre of a pixel of the half lies between two pixels of the whole.
            let expected = [41.5 + 6.0 * x as f64, 198.0 - 8.0 * y as f64, 91.0 + 2.0 * (x + y) as f64];
            for (channel, value) in half[(x, y)].into_iter().zip(expected) {
                assert!((f64::from(channel) - value).abs() <= 1.0, "({x}, {y}): {channel} {value}");
            }
        }
    }
    let again = resize_color(&resize_color(&picture, 80, 60), 40, 30);
    let pairs = again.data.as_flattened().iter().zip(picture.data.as_flattened());
    assert!(pairs.map(|(a, b)| a.abs_diff(*b)).max().unwrap() <= 2);
    assert_eq!(resize_color(&Image::from_vec(0, 0, Vec::new()), 2, 2), Image::filled(2, 2, [0; 3]));
}

#[test]
fn distortion_is_undone_in_colour_and_depth() {
    let k = Intrinsics { width: 160, height: 120, fx: 130.0, fy: 130.0, cx: 81.0, cy: 59.0 };
    let lens = Lens { intrinsics: k, distortion: Distortion::from_opencv([-0.25, 0.08, 0.002, -0.001, 0.0]) };
    // What the lens records: at each recorded pixel the ideal ray's value.
    let ideal = |x: usize, y: usize| lens.to_ideal(&k, x as f64 + 0.5, y as f64 + 0.5).unwrap();
    let recorded = |f: &dyn Fn(f64, f64) -> f64| -> Vec<f64> {
        (0..160 * 120).map(|i| ideal(i % 160, i / 160)).map(|(u, v)| f(u, v)).collect()
    };
    let color_at = |u: f64, v: f64| 120.0 + 0.5 * (u - 80.0) + 0.3 * (v - 60.0);
    let color =
        Image::from_vec(160, 120, recorded(&color_at).iter().map(|&v| [v.round() as u8; 3]).collect());
    let straight = undistort_color(&color, &lens);
    let depth_at = |u: f64, v: f64| 1.0 / (1.2 + 0.002 * (u - 80.0) - 0.004 * (v - 60.0));
    let depth = Image::from_vec(160, 120, recorded(&depth_at).iter().map(|&z| z as f32).collect());
    let target = target_intrinsics(&lens, 80);
    let small = resample_depth(&depth, &lens, &target, &DepthNoise::default());
    for y in 15..105 {
        for x in 15..145 {
            let (u, v) = (x as f64 + 0.5, y as f64 + 0.5);
            assert!((f64::from(straight[(x, y)][0]) - color_at(u, v)).abs() <= 1.1, "{x} {y}");
        }
    }
    for y in 8..52 {
        for x in 8..72 {
            let truth = depth_at(2.0 * x as f64 + 1.0, 2.0 * y as f64 + 1.0);
            assert!((f64::from(small[(x, y)]) - truth).abs() < 1e-4, "{x} {y}");
        }
    }
}

#[test]
fn resampled_frames_of_the_ray_cast_scene_lie_on_its_surfaces() {
    let camera = crate::common::camera(2, 9, 1.2);
    let (_, depth) = crate::common::render(&camera);
    let lens = pinhole(camera.intrinsics);
    let target = target_intrinsics(&lens, 80);
    let small = resample_depth(&depth.map(|&z| z as f32), &lens, &target, &DepthNoise::default());
    let (_, truth) = crate::common::render(&Camera::new(target, camera.x_wc));
    let mut errors: Vec<f64> = small
        .data
        .iter()
        .zip(&truth.data)
        .filter(|(z, t)| **z > 0.0 && **t > 0.0)
        .map(|(z, t)| (f64::from(*z) - t).abs())
        .collect();
    errors.sort_by(f64::total_cmp);
    println!("p50 {:.1e} p95 {:.1e}", errors[errors.len() / 2], errors[errors.len() * 95 / 100]);
    assert!(errors[errors.len() / 2] < 1e-5 && errors[errors.len() * 9 / 10] < 1e-3);
}

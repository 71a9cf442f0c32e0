use super::*;

fn flat(z: f32) -> (DepthImage, Image<f32>) {
    (Image::filled(320, 200, z), Image::filled(320, 200, 1.0))
}

/// Measures white surfaces with the default field of view.
fn measure(camera: &DepthCamera, depth: &DepthImage, cos: &Image<f32>, seed: u64) -> DepthImage {
    let echo = Image::filled(320, 200, 0.8);
    let intrinsics = Intrinsics { width: 320, height: 200, fx: 220.0, fy: 220.0, cx: 160.0, cy: 100.0 };
    let view = DepthView { depth, cos_incidence: cos, echo: &echo, intrinsics: &intrinsics, guide: None };
    camera.measure(&view, Seed(seed)).depth
}

fn mean_and_sigma(values: &[f32]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().map(|&v| f64::from(v)).sum::<f64>() / n;
    (mean, (values.iter().map(|&v| (f64::from(v) - mean).powi(2)).sum::<f64>() / n).sqrt())
}

#[test]
fn the_error_grows_with_the_square_of_the_distance_and_has_no_bias() {
    let camera = DepthCamera { hole_share: 0.0, disparity_step_per_m: 0.0, ..DepthCamera::default() };
    for correlation_px in [0.0, 10.0] {
        let camera = DepthCamera { correlation_px, ..camera.clone() };
        for z in [0.4f32, 0.8, 1.6] {
            let (depth, cos) = flat(z);
            let (mean, sigma) = mean_and_sigma(&measure(&camera, &depth, &cos, 1).data);
            let expected = 0.0004 + 0.0012 * f64::from(z).powi(2);
            assert!((sigma / expected - 1.0).abs() < 0.05, "{z}: {sigma} {expected}");
            assert!((mean - f64::from(z)).abs() < 0.05 * expected);
        }
    }
}

#[test]
fn quantisation_steps_grow_with_the_square_of_the_distance() {
    let camera = DepthCamera { sigma_m: 1e-3, sigma_per_m: 0.0, ..DepthCamera::default() };
    for z in [0.5f32, 1.0] {
        let (depth, cos) = flat(z);
        let mut levels: Vec<f32> =
            measure(&camera, &depth, &cos, 2).data.into_iter().filter(|&v| v > 0.0).collect();
        levels.sort_by(f32::total_cmp);
        levels.dedup();
        let step = levels.windows(2).map(|w| w[1] - w[0]).fold(f32::INFINITY, f32::min);
        let expected = 0.001 * z * z;
        assert!((step / expected - 1.0).abs() < 0.05, "{step} {expected}");
    }
}

#[test]
fn edges_and_grazing_surfaces_lose_measurements_and_slanted_planes_do_not() {
    let camera = DepthCamera { hole_share: 0.0, baseline_m: 0.0, ..DepthCamera::default() };
    let (mut depth, mut cos) = flat(1.0);
    for y in 0..200 {
        for x in 160..320 {
            depth[(x, y)] = 0.6;
        }
        for x in 0..40 {
            cos[(x, y)] = 0.04;
        }
    }
    let measured = measure(&camera, &depth, &cos, 3);
    let valid = |x0: usize, x1: usize| {
        let n: usize = (0..200).map(|y| (x0..x1).filter(|&x| measured[(x, y)] > 0.0).count()).sum();
        n as f64 / (200 * (x1 - x0)) as f64
    };
    assert_eq!(valid(0, 40), 0.0);
    assert_eq!(valid(60, 150), 1.0);
    assert!((valid(159, 161) - 0.4).abs() < 0.12, "{}", valid(159, 161));
    let mut slanted = Image::filled(320, 200, 0.0f32);
    for y in 0..200 {
        for x in 0..320 {
            slanted[(x, y)] = 1.0 / (0.5 + 0.008 * x as f32 + 0.01 * y as f32);
        }
    }
    assert!(edge_band(&slanted, 2).iter().all(|e| !e));
}

#[test]
fn a_perfect_camera_changes_nothing_and_seeds_differ() {
    let (depth, cos) = flat(0.7);
    assert_eq!(measure(&DepthCamera::perfect(), &depth, &cos, 1), depth);
    let camera = DepthCamera::default();
    let a = measure(&camera, &depth, &cos, 1);
    assert_eq!(a, measure(&camera, &depth, &cos, 1));
    assert_ne!(a, measure(&camera, &depth, &cos, 2));
}

#[test]
fn the_shadow_of_a_near_thing_is_as_wide_as_the_difference_of_disparities() {
    let camera = DepthCamera { baseline_m: 0.05, ..DepthCamera::perfect() };
    for (near, far) in [(0.5f32, 0.7f32), (0.4, 1.6)] {
        let (mut depth, cos) = flat(far);
        for y in 0..200 {
            (150..200).for_each(|x| depth[(x, y)] = near);
        }
        let echo = Image::filled(320, 200, 0.8);
        let intrinsics = Intrinsics { width: 320, height: 200, fx: 881.0, fy: 881.0, cx: 160.0, cy: 100.0 };
        let view = DepthView {
            depth: &depth,
            cos_incidence: &cos,
            echo: &echo,
            intrinsics: &intrinsics,
            guide: None,
        };
        let measured = camera.measure(&view, Seed(1)).depth;
        let lost: Vec<usize> = (0..320).filter(|&x| measured[(x, 100)] == 0.0).collect();
        let width = 881.0 * 0.05 * (1.0 / f64::from(near) - 1.0 / f64::from(far));
        // The shadow is at most as wide as the object.
        let expected = width.min(50.0);
        assert!((lost.len() as f64 - expected).abs() <= 1.0, "{} {expected}", lost.len());
        assert!((lost[0] as f64 - (150.0 - width)).abs() <= 1.0, "it begins so far to the left: {lost:?}");
        assert!(lost.windows(2).all(|w| w[1] == w[0] + 1));
    }
    // A slanted plane that both see loses nothing.
    let slanted =
        Image::from_vec(320, 200, (0..64_000).map(|i| 1.0 / (0.5 + 0.004 * (i % 320) as f32)).collect());
    let (_, cos) = flat(1.0);
    assert_eq!(measure(&camera, &slanted, &cos, 1), slanted);
}

#[test]
fn dark_and_glaring_surfaces_have_holes() {
    let camera = DepthCamera { dark_echo: 0.03, glare_echo: 8.0, ..DepthCamera::perfect() };
    let (depth, cos) = flat(0.7);
    let echo =
        Image::from_vec(320, 200, (0..64_000).map(|i| [0.005, 0.01875, 0.04, 9.0][(i % 320) / 80]).collect());
    let intrinsics = Intrinsics { width: 320, height: 200, fx: 220.0, fy: 220.0, cx: 160.0, cy: 100.0 };
    let view =
        DepthView { depth: &depth, cos_incidence: &cos, echo: &echo, intrinsics: &intrinsics, guide: None };
    let measured = camera.measure(&view, Seed(3)).depth;
    let share = |band: usize| {
        let pixels = (0..200).flat_map(|y| (80 * band..80 * band + 80).map(move |x| (x, y)));
        pixels.filter(|&p| measured[p] > 0.0).count() as f64 / 16_000.0
    };
    assert_eq!((share(0), share(2), share(3)), (0.0, 1.0, 0.0));
    assert!((share(1) - 0.5).abs() < 0.02, "half is seen in the middle of the ramp: {}", share(1));
}
#[test]
fn missing_patches_have_their_share_and_size() {
    let (depth, cos) = flat(0.7);
    for (share, size_px) in [(0.64, 1.0), (0.3, 40.0)] {
        let camera = DepthCamera { missing_share: share, missing_px: size_px, ..DepthCamera::perfect() };
        let (mut lost, mut borders) = (0.0, 0.0);
        let n = 40;
        for seed in 0..n {
            let measured = measure(&camera, &depth, &cos, seed);
            lost += measured.data.iter().filter(|z| **z == 0.0).count() as f64 / 64_000.0;
            let empty = |x: usize, y: usize| measured[(x, y)] == 0.0;
            borders += (0..200)
                .map(|y| {
                    (1..320).filter(|&x| empty(x, y) != empty(x - 1, y)).count() as f64 / (200.0 * 319.0)
                })
                .sum::<f64>();
        }
        let (lost, borders) = (lost / n as f64, borders / n as f64);
        assert!((lost / share - 1.0).abs() < 0.05, "{lost} {share}");
        // Independent pixels differ from their neighbours with 2 s (1 − s). Patches of c pixels differ at their borders only: the
        // width is a quarter of 1280, so that 40 pixels are 10.
        let independent = 2.0 * share * (1.0 - share);
        if size_px > 1.0 {
            let per_pixel = borders / independent;
            assert!(per_pixel > 0.5 / 10.0 && per_pixel < 2.0 / 10.0, "{per_pixel}");
        } else {
            assert!((borders / independent - 1.0).abs() < 0.03, "{borders} {independent}");
        }
    }
}

#[test]
fn noise_grows_as_the_returned_light_falls() {
    let camera = DepthCamera { sigma_m: 0.002, light_exponent: 0.5, ..DepthCamera::perfect() };
    let (depth, _) = flat(1.0);
    let sigma = |cos: f32| mean_and_sigma(&measure(&camera, &depth, &Image::filled(320, 200, cos), 1).data).1;
    assert!((sigma(1.0) / 0.002 - 1.0).abs() < 0.02);
    assert!((sigma(0.25) / 0.004 - 1.0).abs() < 0.02, "a quarter of the light doubles the noise");
}

#[test]
fn dark_and_distant_surfaces_return_too_little_light() {
    let camera = DepthCamera { lost_light: 0.1, ..DepthCamera::perfect() };
    // 0.8 / z² is 0.2 at 2 m, 0.1 at 2.83 m, 0.02 at 6.3 m.
    for (z, kept) in [(2.0, 1.0), (6.4, 0.0)] {
        let (depth, cos) = flat(z);
        let share =
            measure(&camera, &depth, &cos, 1).data.iter().filter(|z| **z > 0.0).count() as f64 / 64_000.0;
        assert_eq!(share, kept, "{z}");
    }
}

#[test]
fn mixed_pixels_lie_between_foreground_and_background() {
    let camera = DepthCamera { mixed_px: 8.0, ..DepthCamera::perfect() };
    let (mut depth, cos) = flat(1.2);
    (0..200).for_each(|y| (100..200).for_each(|x| depth[(x, y)] = 0.8));
    let measured = measure(&camera, &depth, &cos, 1);
    let mut between = 0;
    for (x, y) in (0..320).flat_map(|x| (0..200).map(move |y| (x, y))) {
        let z = measured[(x, y)];
        assert!((0.8 - 1e-6..=1.2 + 1e-6).contains(&z));
        let beside = [99usize, 100, 199, 200].iter().any(|&edge| x.abs_diff(edge) <= 2);
        assert!(beside || z == depth[(x, y)], "surfaces keep their depth: {x} {z}");
        between += usize::from(z > 0.81 && z < 1.19);
    }
    // Two edges, about two pixels of radius 8 / 4 at each side.
    assert!(between > 200 * 4, "{between}");
    // The nearer surface returns more light, so that the pixel beyond the edge is nearer than the middle of its shares.
    assert!(measured[(100, 100)] - 0.8 < 1.2 - measured[(99, 100)]);
}

#[test]
fn depth_has_the_camera_s_columns_and_field_of_view() {
    let (depth, cos) = flat(0.7);
    let k = Intrinsics { width: 320, height: 200, fx: 220.0, fy: 220.0, cx: 160.0, cy: 100.0 };
    let own = DepthCamera { columns: 64, fills_image: false, ..DepthCamera::perfect() };
    assert_eq!(measure(&own, &depth, &cos, 1).size(), (64, 40));
    assert_eq!(own.intrinsics(&k), k.scaled_to(64, 40));
    let filled = DepthCamera { columns: 64, ..DepthCamera::perfect() };
    assert_eq!(measure(&filled, &depth, &cos, 1), depth);
    assert_eq!(filled.intrinsics(&k), k);
    let narrow = DepthCamera { fov_rad: [1.0, 0.0], ..DepthCamera::perfect() };
    let measured = measure(&narrow, &depth, &cos, 1);
    let seen = (0..320).filter(|&x| measured[(x, 100)] > 0.0).count() as f64;
    assert!((seen - 2.0 * 220.0 * 0.5f64.tan()).abs() <= 1.0, "{seen}");
}

#[test]
fn measurements_do_not_depend_on_threads() {
    let camera = DepthCamera {
        columns: 160,
        dots: 200,
        smoothing_px: 4.0,
        missing_share: 0.1,
        missing_px: 20.0,
        mixed_px: 6.0,
        multipath: 1.0,
        light_exponent: 0.5,
        has_confidence: true,
        ..DepthCamera::default()
    };
    let (mut depth, cos) = flat(1.2);
    (0..200).for_each(|y| (100..200).for_each(|x| depth[(x, y)] = 0.8 + 0.001 * x as f32));
    let echo = Image::filled(320, 200, 0.6);
    let k = Intrinsics { width: 320, height: 200, fx: 220.0, fy: 220.0, cx: 160.0, cy: 100.0 };
    let view = DepthView { depth: &depth, cos_incidence: &cos, echo: &echo, intrinsics: &k, guide: None };
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| camera.measure(&view, Seed(4)))
    };
    let one = with(1);
    assert_eq!(one, with(3));
    assert!(one.confidence.is_some_and(|c| c.data.iter().max() == Some(&2)));
}

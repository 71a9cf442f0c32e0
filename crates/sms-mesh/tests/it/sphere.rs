//! Sphere fitting under the conditions of a scan.

use rand::RngExt;
use sms_core::Seed;
use sms_core::glamx::DVec3;
use sms_mesh::{SphereConfig, fit_sphere};

#[test]
fn radius_within_a_tenth_of_a_millimetre_at_35_percent_coverage() {
    // 7000 points of a cap 35 % of the sphere with 0.8 mm of noise fix the radius to 0.03 mm (Cramér-Rao). The limit of
    // a tenth of a millimetre over 20 draws is three times as large.
    let (mut worst, mut sum) = (0.0f64, 0.0);
    for seed in 0..20 {
        let mut rng = Seed(seed).rng();
        let mut gauss = {
            let mut rng = Seed(seed + 1000).rng();
            move || (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0
        };
        let (center, radius) = (DVec3::new(0.3, -0.2, 0.0285), 0.0285);
        let mut points = Vec::new();
        while points.len() < 7000 {
            // The share of a sphere above height h is (1 − h) / 2.
            let z = 1.0 - 0.7 * rng.random::<f64>();
            let a = std::f64::consts::TAU * rng.random::<f64>();
            let r = (1.0 - z * z).sqrt();
            let noise = DVec3::new(gauss(), gauss(), gauss()) * 0.0008;
            points.push(center + DVec3::new(r * a.cos(), r * a.sin(), z) * radius + noise);
        }
        for _ in 0..3000 {
            let p = DVec3::new(rng.random(), rng.random(), rng.random());
            points.push(center + (p - DVec3::splat(0.5)) * 0.1);
        }
        let fit = fit_sphere(&points, &SphereConfig::default(), Seed(seed)).unwrap();
        worst = worst.max((fit.radius - radius).abs());
        sum += fit.radius - radius;
        assert!(fit.center.distance(center) < 3e-4, "seed {seed}: {:?}", fit.center - center);
        assert!(fit.coverage > 0.3 && fit.inlier_share > 0.65);
    }
    println!("radius error: worst {:.3} mm, mean {:+.3} mm", 1e3 * worst, 1e3 * sum / 20.0);
    assert!(worst < 1e-4, "{worst}");
    assert!((sum / 20.0).abs() < 2.5e-5, "the fit is biased: {}", sum / 20.0);
}

#[test]
fn planes_and_few_points_give_no_sphere_or_a_poor_one() {
    let plane: Vec<DVec3> =
        (0..400).map(|i| DVec3::new(f64::from(i % 20), f64::from(i / 20), 0.0) * 0.005).collect();
    let share = fit_sphere(&plane, &SphereConfig::default(), Seed(0)).map_or(0.0, |f| f.coverage);
    assert!(share < 0.25);
    assert!(fit_sphere(&plane[..5], &SphereConfig::default(), Seed(0)).is_none());
}

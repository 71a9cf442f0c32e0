//! Segmentation by geometry on scenes with known masks.

use super::*;
use crate::fixture::{Sensor, Solid, best_iou, scene, table_scene};
use glamx::DVec3;
use sms_core::{NoProgress, StageContext, Warnings};

fn segment(sequence: &Sequence) -> (Labels, Warnings) {
    let warnings = Warnings::new();
    let labels =
        GeometryMasks::default().segment(sequence, StageContext::quiet(&Cancel::new(), &warnings)).unwrap();
    (labels, warnings)
}

/// Asserts that every solid is found as one object with at least this overlap, and nothing else is found.
fn assert_found(solids: &[Solid], sensor: Sensor, least: f64) {
    let (sequence, truth) = scene(solids, sensor, 11);
    let began = std::time::Instant::now();
    let (labels, _) = segment(&sequence);
    println!("{} objects in {:.2} s", labels.objects.len(), began.elapsed().as_secs_f64());
    let found: Vec<(f64, u16)> =
        (1..=solids.len() as u16).map(|value| best_iou(&truth, value, &labels)).collect();
    println!("{found:.3?}");
    assert_eq!(labels.objects.len(), solids.len());
    let mut ids: Vec<u16> = found.iter().map(|f| f.1).collect();
    ids.sort_unstable();
    ids.dedup();
    assert_eq!(ids.len(), solids.len(), "each solid has a label of its own");
    for (value, (iou, _)) in found.iter().enumerate() {
        assert!(*iou >= least, "solid {}: IoU {iou:.3}", value + 1);
    }
}

#[test]
fn separate_things_on_a_table_are_found() {
    assert_found(&table_scene(), Sensor::default(), 0.9);
}

#[test]
fn sixty_percent_of_the_depth_may_be_missing() {
    assert_found(&table_scene(), Sensor { missing: 0.6, ..Sensor::default() }, 0.9);
}

#[test]
fn a_box_on_a_box_and_a_ball_on_a_box_are_two_objects_each() {
    let solids = [
        Solid::Box(DVec3::new(0.0, 0.0, 0.03), DVec3::new(0.07, 0.06, 0.03), 0.2),
        Solid::Box(DVec3::new(0.0, 0.01, 0.085), DVec3::new(0.035, 0.03, 0.025), 0.7),
        Solid::Box(DVec3::new(-0.2, 0.1, 0.03), DVec3::new(0.05, 0.05, 0.03), 0.0),
        Solid::Sphere(DVec3::new(-0.2, 0.1, 0.0886), 0.0286),
    ];
    assert_found(&solids, Sensor::default(), 0.88);
}

#[test]
fn things_that_touch_side_by_side_are_separated() {
    let solids = [
        Solid::Sphere(DVec3::new(0.0, 0.0, 0.0286), 0.0286),
        Solid::Sphere(DVec3::new(0.0573, 0.0, 0.0286), 0.0286),
        Solid::Box(DVec3::new(-0.16, 0.1, 0.05), DVec3::new(0.03, 0.04, 0.05), 0.0),
        Solid::Sphere(DVec3::new(-0.1 - 0.0013, 0.1, 0.0286), 0.0286),
    ];
    assert_found(&solids, Sensor::default(), 0.86);
}

#[test]
fn a_ball_against_a_cup_is_another_thing() {
    let (cup, ball) = (0.045, 0.018);
    // Most of the cup is visible inside and outside, so the ball is a detail by surface. Without a search for balls it
    // would stay attached.
    let solids = [
        Solid::Cup(DVec3::ZERO, cup, 0.11),
        Solid::Sphere(DVec3::new(0.6, -0.8, 0.0) * (cup + ball + 0.0005) + DVec3::Z * ball, ball),
    ];
    assert_found(&solids, Sensor::default(), 0.88);
}

#[test]
fn a_marble_against_a_box_is_another_thing() {
    // The marble has less surface than other details.
    let (side, marble) = (0.04, 0.015);
    let solids = [
        Solid::Box(DVec3::new(0.0, 0.0, side), DVec3::splat(side), 0.0),
        Solid::Sphere(DVec3::new(0.01, -side - marble - 0.0005, marble), marble),
    ];
    assert_found(&solids, Sensor { sigma_1m: 0.001, missing: 0.0, ..Sensor::default() }, 0.7);
}

#[test]
fn a_round_head_of_its_body_s_colour_stays_on() {
    let aside = |x: f64| Solid::Box(DVec3::new(x, 0.2, 0.03), DVec3::splat(0.03), 0.0);
    // The sixth object has the colour of the first.
    let solids = [
        Solid::Sphere(DVec3::new(0.0, 0.0, 0.035), 0.035),
        aside(-0.2),
        aside(-0.1),
        aside(0.1),
        aside(0.2),
        Solid::Sphere(DVec3::new(0.0, 0.0, 0.085), 0.025),
    ];
    let (sequence, truth) = scene(&solids, Sensor::default(), 4);
    let (labels, _) = segment(&sequence);
    assert_eq!(labels.objects.len(), 5);
    let [body, head] = [1, 6].map(|value| best_iou(&truth, value, &labels).1);
    assert_eq!(body, head);
}

/// A cube of 12 mm, a rod of 10 mm on the table, and a book 10 mm thick.
fn small_scene() -> Vec<Solid> {
    vec![
        Solid::Box(DVec3::new(0.08, -0.06, 0.006), DVec3::splat(0.006), 0.3),
        Solid::Rod(DVec3::new(-0.05, -0.1, 0.005), DVec3::new(0.05, 0.033, 0.0), 0.005),
        Solid::Box(DVec3::new(-0.02, 0.1, 0.005), DVec3::new(0.09, 0.06, 0.005), -0.4),
    ]
}

/// Asserts that each of the three objects is found in most of its pixels, and nothing else, also after the refinement
/// of edges. A cube of 12 mm has nine pixels in such an image.
fn assert_small_found(sensor: Sensor, least: [f64; 3]) {
    let (sequence, truth) = scene(&small_scene(), sensor, 100);
    let (labels, _) = segment(&sequence);
    let config = GeometryConfig::default();
    let (refined, _) =
        crate::complete(labels.clone(), &sequence, &config, &NoProgress, &Cancel::new()).unwrap();
    for labels in [labels, refined] {
        let found = [1, 2, 3].map(|value| best_iou(&truth, value, &labels));
        println!("cube, rod, book: {found:.3?} of {}", labels.objects.len());
        assert_eq!(labels.objects.len(), 3);
        for (k, (iou, _)) in found.into_iter().enumerate() {
            assert!(iou >= least[k], "solid {}: IoU {iou:.3}", k + 1);
        }
    }
}

#[test]
fn a_cube_of_12_mm_a_rod_of_10_and_a_book_10_mm_thick_are_found() {
    let perfect = Sensor { sigma_1m: 0.0, missing: 0.0, ..Sensor::default() };
    assert_small_found(perfect, [0.7, 0.8, 0.9]);
}

#[test]
fn small_things_are_found_through_noise() {
    assert_small_found(Sensor::default(), [0.7, 0.8, 0.9]);
}

#[test]
fn small_things_are_found_where_two_thirds_of_the_depth_are_missing() {
    assert_small_found(Sensor { missing: 0.667, ..Sensor::default() }, [0.6, 0.7, 0.9]);
}

#[test]
fn an_empty_table_has_no_objects_and_says_so() {
    let (sequence, _) = scene(&[], Sensor { frames: 6, ..Sensor::default() }, 2);
    let (labels, warnings) = segment(&sequence);
    assert!(labels.objects.is_empty() && labels.maps.len() == 6);
    assert_eq!(warnings.snapshot()[0].code, "no_objects");
}

#[test]
fn a_plank_that_is_too_long_for_a_thing_is_named() {
    // On a block, so that the table is visible beyond the block's rim.
    let solids = [
        Solid::Box(DVec3::new(0.0, 0.0, 0.05), DVec3::new(0.05, 0.05, 0.05), 0.0),
        Solid::Box(DVec3::new(0.0, 0.0, 0.11), DVec3::new(0.26, 0.1, 0.01), 0.3),
    ];
    let (sequence, _) = scene(&solids, Sensor::default(), 7);
    let warnings_with = |max_structure_m: f64| {
        let config = GeometryConfig { max_structure_m, ..GeometryConfig::default() };
        let warnings = Warnings::new();
        GeometryMasks { config }.segment(&sequence, StageContext::quiet(&Cancel::new(), &warnings)).unwrap();
        warnings.snapshot()
    };
    let short = warnings_with(0.45);
    assert!(short.iter().any(|w| w.code == "oversize"), "{short:?}");
    assert!(!warnings_with(1.0).iter().any(|w| w.code == "oversize"));
}

#[test]
fn a_free_standing_assembly_may_be_longer_than_a_structure() {
    let solids = [Solid::Box(DVec3::new(0.0, 0.0, 0.25), DVec3::new(0.1, 0.08, 0.25), 0.2)];
    let (sequence, truth) = scene(&solids, Sensor::default(), 7);
    let found = |max_structure_m: f64| {
        let config = GeometryConfig { max_structure_m, max_object_m: 0.3, ..GeometryConfig::default() };
        let masks = GeometryMasks { config };
        let labels = masks.segment(&sequence, StageContext::quiet(&Cancel::new(), &Warnings::new())).unwrap();
        if labels.objects.is_empty() { 0.0 } else { best_iou(&truth, 1, &labels).0 }
    };
    // 0.5 m is less than 1.5 times 0.38 m, but more than 1.5 times 0.3 m.
    assert!(found(0.38) > 0.9);
    assert!(found(0.3) < 0.1);
}

#[test]
fn walls_and_a_bin_floor_are_static() {
    let mut solids = vec![
        Solid::Sphere(DVec3::new(0.0, 0.0, 0.0286), 0.0286),
        Solid::Box(DVec3::new(0.1, 0.08, 0.04), DVec3::new(0.03, 0.03, 0.04), 0.3),
    ];
    let objects = solids.len();
    // A wall and a low lip, both larger than an object.
    solids.push(Solid::Box(DVec3::new(-0.25, 0.0, 0.15), DVec3::new(0.003, 0.3, 0.15), 0.0));
    solids.push(Solid::Box(DVec3::new(0.0, -0.25, 0.03), DVec3::new(0.25, 0.003, 0.03), 0.0));
    let (sequence, truth) = scene(&solids, Sensor::default(), 5);
    let (labels, _) = segment(&sequence);
    assert_eq!(labels.objects.len(), objects);
    for value in 1..=objects as u16 {
        let (iou, _) = best_iou(&truth, value, &labels);
        assert!(iou > 0.88, "solid {value}: {iou:.3}");
    }
}

#[test]
fn a_flat_thing_is_not_its_own_support_where_the_support_is_hardly_measured() {
    let solids = [
        Solid::Box(DVec3::new(-0.1, 0.0, 0.06), DVec3::new(0.05, 0.06, 0.06), 0.2),
        Solid::Box(DVec3::new(0.08, 0.0, 0.0125), DVec3::new(0.04, 0.09, 0.0125), 0.2),
    ];
    let (mut sequence, truth) = scene(&solids, Sensor::default(), 6);
    // Bare metal: only scattered depth, in patches of 3 cm every 12 cm.
    for (frame, map) in sequence.frames.iter_mut().zip(&truth) {
        for i in (0..map.data.len()).filter(|&i| map.data[i] == 0) {
            let p_w =
                frame.camera.unproject_pixel(i % map.width, i / map.width, f64::from(frame.depth.data[i]));
            let is_patch = |v: f64| v.rem_euclid(0.12) < 0.03;
            if !is_patch(p_w.x) || !is_patch(p_w.y) {
                frame.depth.data[i] = 0.0;
            }
        }
    }
    let (labels, _) = segment(&sequence);
    assert_eq!(labels.objects.len(), 2);
    for value in [1, 2] {
        let (iou, _) = best_iou(&truth, value, &labels);
        println!("solid {value}: {iou:.3}");
        assert!(iou > 0.8, "solid {value}: {iou:.3}");
    }
}

#[test]
fn labels_do_not_depend_on_the_number_of_threads() {
    let (sequence, _) = scene(&table_scene(), Sensor { frames: 8, ..Sensor::default() }, 7);
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| segment(&sequence).0)
    };
    assert_eq!(with(1), with(2));
}

/// A closed box with a lid 12 mm below its rim, all of one colour, is one object.
#[test]
fn a_lid_within_its_rim_is_part_of_its_box() {
    let (half, rim, deep) = (DVec3::new(0.17, 0.13, 0.19), 0.008, 0.006);
    let top = 2.0 * half.z + deep;
    let solids = [
        Solid::Box(DVec3::new(0.0, 0.0, half.z), half, 0.0),
        Solid::Box(DVec3::new(half.x - rim, 0.0, top), DVec3::new(rim, half.y, deep), 0.0),
        Solid::Box(DVec3::new(rim - half.x, 0.0, top), DVec3::new(rim, half.y, deep), 0.0),
        Solid::Box(DVec3::new(0.0, half.y - rim, top), DVec3::new(half.x, rim, deep), 0.0),
        Solid::Box(DVec3::new(0.0, rim - half.y, top), DVec3::new(half.x, rim, deep), 0.0),
    ];
    let (mut sequence, mut truth) = scene(&solids, Sensor { size: (320, 200), ..Sensor::default() }, 3);
    for (frame, labels) in sequence.frames.iter_mut().zip(&mut truth) {
        for (label, color) in labels.data.iter_mut().zip(&mut frame.color.data).filter(|(l, _)| **l > 0) {
            (*label, *color) = (1, [80, 90, 95]);
        }
    }
    let config = GeometryConfig { max_object_m: 0.3, ..GeometryConfig::default() };
    let masks = GeometryMasks { config };
    let labels = masks.segment(&sequence, StageContext::quiet(&Cancel::new(), &Warnings::new())).unwrap();
    let iou = best_iou(&truth, 1, &labels).0;
    assert_eq!(labels.objects.len(), 1, "IoU {iou:.3}");
    assert!(iou > 0.9, "{iou}");
}

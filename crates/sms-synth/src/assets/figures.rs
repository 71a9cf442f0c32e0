//! Statues and toys.

use super::blueprint::{AssetBlueprint, SEGMENTS, brass};
use crate::random::{pick, uniform};
use crate::shapes::{Ellipsoid, between, cuboid_union, ellipsoid_union, lathe_solid};
use crate::texture::{Pattern, Spot, Texture};
use sms_core::StageRng;

/// Mesh size of figures made of ellipsoids; at 5 mm chords lie 0.2 mm below a surface of 15 mm radius.
const FIGURE_CELL_M: f64 = 0.005;

pub(super) fn turned_statue(rng: &mut StageRng, size: f64, of_brass: bool) -> AssetBlueprint {
    let (height, base) = (uniform(rng, [0.11, 0.16]) * size, uniform(rng, [0.034, 0.042]) * size);
    let head = uniform(rng, [0.52, 0.62]) * base;
    // A chess pawn: stepped base, waist, collar, round head.
    let mut profile = vec![
        (base - 0.002, 0.0),
        (base, 0.003),
        (base, 0.07 * height),
        (0.84 * base, 0.10 * height),
        (0.80 * base, 0.16 * height),
        (0.62 * base, 0.22 * height),
        (0.46 * base, 0.34 * height),
        (0.38 * base, 0.50 * height),
        (0.36 * base, 0.58 * height),
        (0.62 * base, 0.61 * height),
        (0.62 * base, 0.64 * height),
        (0.36 * base, 0.66 * height),
    ];
    let center = height - head;
    let start = (0.36 * base / head).asin();
    for i in 1..=10 {
        let angle =
            std::f64::consts::PI - start - f64::from(i) / 10.0 * (std::f64::consts::PI - start - 0.12);
        let z = center + head * angle.cos();
        if z > 0.66 * height + 5e-4 {
            profile.push((head * angle.sin(), z));
        }
    }
    let (name, class, material, texture) = if of_brass {
        let colors = ([222, 182, 102], [176, 132, 64]);
        let texture = brass(Texture::drawn(rng, Pattern::Marble, colors, 0.035, 0.9));
        ("brass_statue", "brass statue", "brass", texture)
    } else {
        let colors = pick(rng, &[([222, 220, 214], [110, 112, 122]), ([90, 112, 98], [206, 214, 200])]);
        let texture = Texture::drawn(rng, Pattern::Marble, colors, 0.025, 0.72);
        ("marble_statue", "marble statue", "marble", texture)
    };
    AssetBlueprint::new(name, class, material, lathe_solid(&profile, SEGMENTS), texture)
}

fn scaled(blobs: &[([f64; 3], [f64; 3])], s: f64) -> Vec<Ellipsoid> {
    blobs.iter().map(|(c, r)| Ellipsoid::new(c.map(|v| v * s), r.map(|v| v * s))).collect()
}

fn spots(list: &[([f64; 3], [f64; 3], [u8; 3])], s: f64) -> Vec<Spot> {
    list.iter()
        .map(|(c, r, color)| Spot {
            center: c.map(|v| (v * s) as f32),
            radii: r.map(|v| (v * s) as f32),
            color: *color,
        })
        .collect()
}

pub(super) fn toy_duck(rng: &mut StageRng, size: f64) -> AssetBlueprint {
    let s = uniform(rng, [0.95, 1.2]) * size;
    let blobs = scaled(
        &[
            ([0.0, 0.0, 0.030], [0.052, 0.040, 0.036]),
            ([-0.048, 0.0, 0.052], [0.022, 0.018, 0.016]),
            ([0.030, 0.0, 0.080], [0.029, 0.028, 0.028]),
            ([0.062, 0.0, 0.075], [0.018, 0.014, 0.007]),
            ([-0.006, 0.034, 0.038], [0.030, 0.012, 0.018]),
            ([-0.006, -0.034, 0.038], [0.030, 0.012, 0.018]),
        ],
        s,
    );
    let mut texture = Texture::drawn(rng, Pattern::Plain, ([240, 196, 36], [220, 160, 20]), 0.018, 0.45);
    texture.spots = spots(
        &[
            ([0.050, 0.017, 0.090], [0.007, 0.007, 0.007], [16, 16, 20]),
            ([0.050, -0.017, 0.090], [0.007, 0.007, 0.007], [16, 16, 20]),
            ([0.068, 0.0, 0.075], [0.016, 0.018, 0.010], [232, 98, 24]),
        ],
        s,
    );
    AssetBlueprint::new("toy_duck", "rubber duck", "rubber", ellipsoid_union(&blobs, FIGURE_CELL_M), texture)
}

pub(super) fn ceramic_bear(rng: &mut StageRng, size: f64) -> AssetBlueprint {
    let s = uniform(rng, [0.95, 1.15]) * size;
    let blobs = scaled(
        &[
            ([0.0, 0.0, 0.038], [0.036, 0.040, 0.042]),
            ([0.004, 0.0, 0.098], [0.030, 0.033, 0.029]),
            ([0.032, 0.0, 0.092], [0.013, 0.014, 0.011]),
            ([0.0, 0.026, 0.123], [0.008, 0.012, 0.012]),
            ([0.0, -0.026, 0.123], [0.008, 0.012, 0.012]),
            ([0.030, 0.028, 0.012], [0.026, 0.015, 0.015]),
            ([0.030, -0.028, 0.012], [0.026, 0.015, 0.015]),
            ([0.020, 0.040, 0.050], [0.018, 0.011, 0.020]),
            ([0.020, -0.040, 0.050], [0.018, 0.011, 0.020]),
        ],
        s,
    );
    let colors = pick(rng, &[([150, 96, 60], [110, 66, 38]), ([96, 140, 176], [60, 96, 130])]);
    let mut texture = Texture::drawn(rng, Pattern::Speckle, colors, 0.010, 0.78);
    texture.spots = spots(
        &[
            ([0.044, 0.0, 0.096], [0.006, 0.006, 0.005], [24, 18, 18]),
            ([0.034, 0.013, 0.108], [0.006, 0.005, 0.005], [24, 18, 18]),
            ([0.034, -0.013, 0.108], [0.006, 0.005, 0.005], [24, 18, 18]),
            ([0.036, 0.0, 0.090], [0.013, 0.013, 0.011], [228, 206, 176]),
            ([0.036, 0.0, 0.042], [0.016, 0.024, 0.026], [228, 206, 176]),
        ],
        s,
    );
    AssetBlueprint::new(
        "ceramic_bear",
        "ceramic bear",
        "ceramic",
        ellipsoid_union(&blobs, FIGURE_CELL_M),
        texture,
    )
}

/// A figure that sits with crossed legs, its hands in its lap.
pub(super) fn seated_statue(rng: &mut StageRng, size: f64) -> AssetBlueprint {
    let s = uniform(rng, [0.95, 1.15]) * size;
    let blobs = scaled(
        &[
            ([0.010, 0.0, 0.016], [0.046, 0.058, 0.020]),
            ([0.0, 0.0, 0.050], [0.028, 0.034, 0.040]),
            ([0.0, 0.0, 0.082], [0.024, 0.038, 0.022]),
            ([0.008, 0.036, 0.060], [0.016, 0.014, 0.030]),
            ([0.008, -0.036, 0.060], [0.016, 0.014, 0.030]),
            ([0.028, 0.0, 0.036], [0.018, 0.028, 0.012]),
            ([0.002, 0.0, 0.114], [0.021, 0.020, 0.024]),
            ([0.0, 0.0, 0.138], [0.010, 0.010, 0.010]),
        ],
        s,
    );
    let colors = pick(rng, &[([214, 212, 204], [150, 148, 150]), ([112, 128, 116], [190, 200, 188])]);
    let solid = ellipsoid_union(&blobs, FIGURE_CELL_M);
    let texture = Texture::drawn(rng, Pattern::Marble, colors, 0.03, 0.72);
    AssetBlueprint::new("seated_statue", "marble statue", "marble", solid, texture)
}

pub(super) fn toy_robot(rng: &mut StageRng, size: f64) -> AssetBlueprint {
    let s = uniform(rng, [0.9, 1.15]) * size;
    let block = |min: [f64; 3], max: [f64; 3]| between(min.map(|v| v * s), max.map(|v| v * s));
    let boxes = [
        block([-0.022, -0.034, 0.0], [0.030, -0.008, 0.036]),
        block([-0.022, 0.008, 0.0], [0.030, 0.034, 0.036]),
        block([-0.022, -0.038, 0.036], [0.022, 0.038, 0.090]),
        block([-0.014, -0.056, 0.044], [0.014, -0.038, 0.084]),
        block([-0.014, 0.038, 0.044], [0.014, 0.056, 0.084]),
        block([-0.018, -0.022, 0.090], [0.020, 0.022, 0.124]),
    ];
    let colors = pick(
        rng,
        &[([210, 52, 44], [246, 206, 60]), ([44, 150, 88], [240, 240, 236]), ([230, 120, 30], [40, 60, 120])],
    );
    let mut texture = Texture::drawn(rng, Pattern::Plain, colors, 0.02, 0.6);
    texture.spots = spots(
        &[
            ([0.020, 0.010, 0.110], [0.004, 0.006, 0.006], [20, 24, 34]),
            ([0.020, -0.010, 0.110], [0.004, 0.006, 0.006], [20, 24, 34]),
            ([0.020, 0.0, 0.098], [0.004, 0.012, 0.003], [20, 24, 34]),
            ([0.0, 0.0, 0.108], [0.05, 0.05, 0.018], colors.1),
            ([0.0, 0.060, 0.050], [0.04, 0.02, 0.012], colors.1),
            ([0.0, -0.060, 0.050], [0.04, 0.02, 0.012], colors.1),
            ([0.022, 0.0, 0.066], [0.003, 0.020, 0.012], colors.1),
            ([0.022, 0.0, 0.004], [0.06, 0.06, 0.010], [60, 62, 70]),
        ],
        s,
    );
    AssetBlueprint::new("toy_robot", "plastic toy robot", "plastic", cuboid_union(&boxes, 0.008), texture)
}

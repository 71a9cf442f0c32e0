//! The asset catalogue: household objects generated in code, each with seeded proportions, colours and material.

use crate::materials::{draw_material, with_effective_density};
use crate::scene::{Hollow, TruthObject};
use crate::shapes::{
    Cuboid, Ellipsoid, Handle, Solid, chamfered_cuboid, cuboid_union, ellipsoid_union, gridded_cuboid,
    lathe_solid, lathe_vessel,
};
use crate::texture::{Pattern, Spot, Texture};
use glamx::{DMat3, DPose3, DQuat, DVec2, DVec3};
use rand::RngExt;
use serde::{Deserialize, Serialize};
use sms_core::{
    InertiaError, MassProperties, Mesh, StageRng, polyhedron_mass_properties, sphere_mass_properties,
};

/// Radius of a pool ball, metres (57.15 mm diameter).
pub const BALL_RADIUS_M: f64 = 0.028575;

/// Facets around a turned object.
const SEGMENTS: usize = 32;

/// Mesh size of figures made of ellipsoids; at 5 mm chords lie 0.2 mm below a surface of 15 mm radius.
const FIGURE_CELL_M: f64 = 0.005;

/// The kinds of obstacles.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AssetKind {
    /// Closed box of corrugated board, light.
    CardboardBox,
    /// Solid chamfered block.
    WoodBlock,
    /// Open bowl.
    Bowl,
    /// Cup with a handle.
    Mug,
    /// Open vase with a waist.
    Vase,
    /// Closed plastic bottle.
    Bottle,
    /// Plate.
    Plate,
    /// Heavy turned statue of brass.
    BrassStatue,
    /// Heavy turned statue of marble.
    MarbleStatue,
    /// Duck of rubber.
    ToyDuck,
    /// Bear of glazed ceramic.
    CeramicBear,
    /// Robot of plastic bricks.
    ToyRobot,
    /// Small football.
    SoccerBall,
}

impl AssetKind {
    /// All kinds, in a fixed order.
    pub const ALL: [Self; 13] = [
        Self::CardboardBox,
        Self::WoodBlock,
        Self::Bowl,
        Self::Mug,
        Self::Vase,
        Self::Bottle,
        Self::Plate,
        Self::BrassStatue,
        Self::MarbleStatue,
        Self::ToyDuck,
        Self::CeramicBear,
        Self::ToyRobot,
        Self::SoccerBall,
    ];
}

/// An asset in its frame `A`: standing on z = 0, axis at x = y = 0.
#[derive(Debug, Clone)]
struct Blueprint {
    name: &'static str,
    class: &'static str,
    material: &'static str,
    solid: Solid,
    /// The air inside a closed shell.
    void: Option<Mesh>,
    hollow: HollowKind,
    sphere_radius: Option<f64>,
    texture: Texture,
}

#[derive(Debug, Clone, Copy)]
enum HollowKind {
    Solid,
    Vessel(f64),
    Shell(f64),
}

fn uniform(rng: &mut StageRng, low: f64, high: f64) -> f64 {
    low + (high - low) * rng.random::<f64>()
}

fn pick<T: Copy>(rng: &mut StageRng, of: &[T]) -> T {
    of[rng.random_range(0..of.len())]
}

fn texture(
    rng: &mut StageRng,
    pattern: Pattern,
    colors: ([u8; 3], [u8; 3]),
    scale_m: f32,
    gloss: f32,
) -> Texture {
    let seed = rng.random::<u32>();
    Texture { pattern, color: colors.0, accent: colors.1, scale_m, seed, gloss, spots: Vec::new() }
}

/// Makes an obstacle standing at `p_w` on the floor, turned by `yaw` radians about z.
pub(crate) fn make_asset(
    kind: AssetKind,
    p_w: DVec2,
    yaw: f64,
    size: f64,
    rng: &mut StageRng,
) -> TruthObject {
    let blueprint = match kind {
        AssetKind::CardboardBox => cardboard_box(rng, size),
        AssetKind::WoodBlock => wood_block(rng, size),
        AssetKind::Bowl => bowl(rng, size),
        AssetKind::Mug => mug(rng, size),
        AssetKind::Vase => vase(rng, size),
        AssetKind::Bottle => bottle(rng, size),
        AssetKind::Plate => plate(rng, size),
        AssetKind::BrassStatue => turned_statue(rng, size, true),
        AssetKind::MarbleStatue => turned_statue(rng, size, false),
        AssetKind::ToyDuck => toy_duck(rng, size),
        AssetKind::CeramicBear => ceramic_bear(rng, size),
        AssetKind::ToyRobot => toy_robot(rng, size),
        AssetKind::SoccerBall => soccer_ball(rng, size),
    };
    place(blueprint, p_w, yaw, rng)
}

/// The cue ball (white) or the target ball (saturated blue) at `p_w`.
pub(crate) fn make_pool_ball(cue: bool, p_w: DVec2, rng: &mut StageRng) -> TruthObject {
    let colors = if cue { ([238, 236, 226], [214, 206, 184]) } else { ([18, 48, 190], [40, 96, 235]) };
    let mut blueprint = ball(
        BALL_RADIUS_M,
        texture(rng, Pattern::Speckle, colors, 0.006, 0.9),
        if cue { "cue_ball" } else { "target_ball" },
        "billiard ball",
        "phenolic_resin",
    );
    if !cue {
        // The numbered disc of a pool ball, on two sides.
        let r = BALL_RADIUS_M as f32;
        for side in [-1.0f32, 1.0] {
            let center = [side * r * 0.8, 0.0, r * 1.6];
            blueprint.texture.spots.push(Spot { center, radii: [0.010; 3], color: [235, 235, 225] });
        }
    }
    place(blueprint, p_w, uniform(rng, 0.0, std::f64::consts::TAU), rng)
}

fn ball(
    radius: f64,
    texture: Texture,
    name: &'static str,
    class: &'static str,
    material: &'static str,
) -> Blueprint {
    let mut mesh = Mesh::icosphere(radius, 4);
    mesh.vertices.iter_mut().for_each(|v| v.z += radius);
    Blueprint {
        name,
        class,
        material,
        solid: Solid { mesh, parts: Vec::new() },
        void: None,
        hollow: HollowKind::Solid,
        sphere_radius: Some(radius),
        texture,
    }
}

fn soccer_ball(rng: &mut StageRng, size: f64) -> Blueprint {
    let radius = uniform(rng, 0.058, 0.072) * size;
    let colors = ([236, 236, 232], pick(rng, &[[24, 24, 28], [150, 20, 30], [16, 70, 60]]));
    let texture = texture(rng, Pattern::Soccer, colors, radius as f32, 0.35);
    let mut blueprint = ball(radius, texture, "soccer_ball", "small soccer ball", "synthetic_leather");
    blueprint.hollow = HollowKind::Shell(uniform(rng, 0.0025, 0.004));
    blueprint
}

fn cardboard_box(rng: &mut StageRng, size: f64) -> Blueprint {
    let extents =
        DVec3::new(uniform(rng, 0.11, 0.16), uniform(rng, 0.08, 0.11), uniform(rng, 0.07, 0.13)) * size;
    let wall = uniform(rng, 0.003, 0.004);
    let mut void = Mesh::cuboid(0.5 * extents - DVec3::splat(wall));
    void.vertices.iter_mut().for_each(|v| v.z += 0.5 * extents.z);
    let colors = (pick(rng, &[[186, 140, 92], [172, 126, 82], [198, 156, 106]]), [70, 46, 30]);
    Blueprint {
        name: "cardboard_box",
        class: "cardboard box",
        material: "cardboard",
        solid: gridded_cuboid(extents, 0.008),
        void: Some(void),
        hollow: HollowKind::Shell(wall),
        sphere_radius: None,
        texture: texture(rng, Pattern::Cardboard, colors, (0.3 * extents.z) as f32, 0.05),
    }
}

fn wood_block(rng: &mut StageRng, size: f64) -> Blueprint {
    let extents =
        DVec3::new(uniform(rng, 0.09, 0.15), uniform(rng, 0.06, 0.09), uniform(rng, 0.05, 0.09)) * size;
    let colors = pick(rng, &[([206, 160, 104], [150, 98, 52]), ([172, 112, 66], [112, 64, 34])]);
    Blueprint {
        name: "wood_block",
        class: "wooden block",
        material: "wood",
        solid: chamfered_cuboid(extents, 0.003),
        void: None,
        hollow: HollowKind::Solid,
        sphere_radius: None,
        texture: texture(rng, Pattern::Wood, colors, 0.03, 0.12),
    }
}

const GLAZES: [([u8; 3], [u8; 3]); 5] = [
    ([228, 222, 206], [48, 84, 140]),
    ([196, 74, 52], [238, 220, 190]),
    ([70, 132, 120], [226, 222, 200]),
    ([226, 178, 72], [120, 60, 36]),
    ([92, 70, 128], [222, 206, 226]),
];

fn bowl(rng: &mut StageRng, size: f64) -> Blueprint {
    let (rim, height) = (uniform(rng, 0.065, 0.08) * size, uniform(rng, 0.05, 0.06) * size);
    let wall = uniform(rng, 0.0045, 0.0055);
    let (base, floor) = (0.45 * rim, 0.008);
    // Outside: a quarter of an ellipse from the foot to the rim. Inside: its parallel curve, from where the wall has
    // its full thickness at the height of the cavity's flat bottom.
    let (a, b) = (rim - base, height);
    let first = (1.0 - floor / height).acos();
    let bands = 6;
    let mut outer = vec![(base, 0.0)];
    let mut inner = Vec::new();
    for i in 0..=bands {
        let angle = first + (std::f64::consts::FRAC_PI_2 - first) * f64::from(i) / f64::from(bands);
        let (r, z) = (base + a * angle.sin(), b * (1.0 - angle.cos()));
        let normal = DVec2::new(angle.sin() / a, -angle.cos() / b).normalize();
        outer.push((r, z));
        inner.push(if i == 0 {
            (r - wall / normal.x, z)
        } else {
            (r - wall * normal.x, z - wall * normal.y)
        });
    }
    inner[0].1 = outer[1].1;
    let glaze = pick(rng, &GLAZES);
    Blueprint {
        name: "bowl",
        class: "ceramic bowl",
        material: "ceramic",
        solid: lathe_vessel(&outer, &inner, SEGMENTS, None),
        void: None,
        hollow: HollowKind::Vessel(wall),
        sphere_radius: None,
        texture: texture(rng, Pattern::Bands, glaze, 0.022, 0.5),
    }
}

fn plate(rng: &mut StageRng, size: f64) -> Blueprint {
    let rim = uniform(rng, 0.075, 0.09) * size;
    let (height, wall, floor) = (uniform(rng, 0.020, 0.026), 0.005, 0.006);
    let outer = [(0.58 * rim, 0.0), (0.64 * rim, floor), (0.84 * rim, 0.62 * height), (rim, height)];
    let inner = [(0.50 * rim, floor), (0.82 * rim, 0.62 * height + wall), (rim - 0.002, height + 0.8 * wall)];
    let glaze = pick(rng, &GLAZES);
    Blueprint {
        name: "plate",
        class: "ceramic plate",
        material: "ceramic",
        solid: lathe_vessel(&outer, &inner, SEGMENTS, None),
        void: None,
        hollow: HollowKind::Vessel(wall),
        sphere_radius: None,
        texture: texture(rng, Pattern::Bands, glaze, 0.008, 0.5),
    }
}

fn mug(rng: &mut StageRng, size: f64) -> Blueprint {
    let (radius, height) = (uniform(rng, 0.038, 0.044) * size, uniform(rng, 0.085, 0.10) * size);
    let (wall, floor) = (uniform(rng, 0.0042, 0.005), 0.007);
    let band = 0.1 * height;
    let low = uniform(rng, 0.2, 0.26) * height;
    let high = uniform(rng, 0.68, 0.74) * height;
    let z = [0.003, floor, low, low + band, high, high + band, height - 0.002];
    let mut outer: Vec<_> = z.iter().map(|&z| (radius, z)).collect();
    outer[0] = (radius - 0.002, 0.0);
    let mut inner: Vec<_> = z[1..].iter().map(|&z| (radius - wall, z)).collect();
    outer.push((radius - 0.001, height));
    inner.push((radius - wall + 0.001, height));
    let handle = Handle { low_band: 2, high_band: 4, reach: uniform(rng, 0.026, 0.032), thickness: 0.0085 };
    let glaze = pick(rng, &GLAZES);
    Blueprint {
        name: "mug",
        class: "ceramic mug",
        material: "ceramic",
        solid: lathe_vessel(&outer, &inner, SEGMENTS, Some(handle)),
        void: None,
        hollow: HollowKind::Vessel(wall),
        sphere_radius: None,
        texture: texture(rng, Pattern::Bands, glaze, (height / 2.6) as f32, 0.5),
    }
}

fn vase(rng: &mut StageRng, size: f64) -> Blueprint {
    let (height, belly) = (uniform(rng, 0.14, 0.19) * size, uniform(rng, 0.042, 0.052) * size);
    let (neck, wall, floor) = (uniform(rng, 0.018, 0.024) * size, 0.005, 0.010);
    let base = 0.7 * belly;
    let bands = 11;
    let mut outer = vec![(base, 0.0)];
    let mut inner = Vec::new();
    for i in 0..=bands {
        let t = i as f64 / bands as f64;
        let z = floor + (height - floor) * t;
        // A belly at 35 % of the height, a neck at 80 %, a flared lip.
        let bulge = (-(t - 0.35).powi(2) / 0.055).exp();
        let lip = 0.55 * neck * ((t - 0.80).max(0.0) / 0.20).powi(2);
        let r =
            neck + lip + (belly - neck) * bulge + (base - neck) * (1.0 - t / 0.25).max(0.0).powi(2) * 0.55;
        outer.push((r, z));
        inner.push((r - wall, z));
    }
    outer[0].0 = outer[1].0 - 0.003;
    let glaze = pick(rng, &GLAZES);
    let pattern = pick(rng, &[Pattern::Bands, Pattern::Marble]);
    Blueprint {
        name: "vase",
        class: "ceramic vase",
        material: "ceramic",
        solid: lathe_vessel(&outer, &inner, SEGMENTS, None),
        void: None,
        hollow: HollowKind::Vessel(wall),
        sphere_radius: None,
        texture: texture(rng, pattern, glaze, 0.03, 0.5),
    }
}

fn bottle(rng: &mut StageRng, size: f64) -> Blueprint {
    let (radius, height) = (uniform(rng, 0.030, 0.037) * size, uniform(rng, 0.15, 0.19) * size);
    let (neck, cap) = (0.42 * radius, 0.52 * radius);
    let mut profile =
        vec![(radius - 0.003, 0.0), (radius, 0.004), (radius, 0.30 * height), (radius, 0.60 * height)];
    for i in 1..=5 {
        // The shoulder: a quarter of a cosine from the body to the neck.
        let t = f64::from(i) / 5.0;
        let blend = 0.5 - 0.5 * (t * std::f64::consts::PI).cos();
        profile.push((radius + (neck - radius) * blend, (0.60 + 0.22 * t) * height));
    }
    profile.extend([
        (neck, 0.85 * height),
        (cap, 0.852 * height),
        (cap, 0.985 * height),
        (0.85 * cap, height),
    ]);
    let wall = uniform(rng, 0.0014, 0.0022);
    let inner: Vec<_> = profile.iter().map(|&(r, z)| (r - wall, z.clamp(wall, height - wall))).collect();
    let mut void = vec![inner[0]];
    void.extend(inner.windows(2).filter(|w| w[1].1 > w[0].1).map(|w| w[1]));
    let colors = pick(
        rng,
        &[
            ([224, 126, 34], [248, 244, 232]),
            ([36, 142, 92], [246, 232, 120]),
            ([178, 40, 92], [240, 236, 236]),
        ],
    );
    let mut texture = texture(rng, Pattern::Bands, colors, 0.05, 0.55);
    let cap_color = [40, 44, 60];
    let cap_height = (0.08 * height) as f32;
    texture.spots.push(Spot {
        center: [0.0, 0.0, (0.925 * height) as f32],
        radii: [0.1, 0.1, cap_height],
        color: cap_color,
    });
    // A label around the body.
    texture.spots.push(Spot {
        center: [0.0, -(radius as f32), (0.32 * height) as f32],
        radii: [radius as f32 * 0.9, radius as f32 * 0.8, (0.17 * height) as f32],
        color: colors.1,
    });
    Blueprint {
        name: "bottle",
        class: "plastic bottle",
        material: "plastic",
        solid: lathe_solid(&profile, SEGMENTS),
        void: Some(lathe_solid(&void, SEGMENTS).mesh),
        hollow: HollowKind::Shell(wall),
        sphere_radius: None,
        texture,
    }
}

fn turned_statue(rng: &mut StageRng, size: f64, brass: bool) -> Blueprint {
    let (height, base) = (uniform(rng, 0.11, 0.16) * size, uniform(rng, 0.034, 0.042) * size);
    let head = uniform(rng, 0.52, 0.62) * base;
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
    let (name, class, material, texture) = if brass {
        let colors = ([196, 152, 70], [112, 76, 30]);
        ("brass_statue", "brass statue", "brass", texture(rng, Pattern::Marble, colors, 0.035, 0.9))
    } else {
        let colors = pick(rng, &[([222, 220, 214], [110, 112, 122]), ([90, 112, 98], [206, 214, 200])]);
        ("marble_statue", "marble statue", "marble", texture(rng, Pattern::Marble, colors, 0.025, 0.6))
    };
    Blueprint {
        name,
        class,
        material,
        solid: lathe_solid(&profile, SEGMENTS),
        void: None,
        hollow: HollowKind::Solid,
        sphere_radius: None,
        texture,
    }
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

fn toy_duck(rng: &mut StageRng, size: f64) -> Blueprint {
    let s = uniform(rng, 0.95, 1.2) * size;
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
    let mut texture = texture(rng, Pattern::Plain, ([240, 196, 36], [220, 160, 20]), 0.018, 0.3);
    texture.spots = spots(
        &[
            ([0.050, 0.017, 0.090], [0.007, 0.007, 0.007], [16, 16, 20]),
            ([0.050, -0.017, 0.090], [0.007, 0.007, 0.007], [16, 16, 20]),
            ([0.068, 0.0, 0.075], [0.016, 0.018, 0.010], [232, 98, 24]),
        ],
        s,
    );
    Blueprint {
        name: "toy_duck",
        class: "rubber duck",
        material: "rubber",
        solid: ellipsoid_union(&blobs, FIGURE_CELL_M),
        void: None,
        hollow: HollowKind::Solid,
        sphere_radius: None,
        texture,
    }
}

fn ceramic_bear(rng: &mut StageRng, size: f64) -> Blueprint {
    let s = uniform(rng, 0.95, 1.15) * size;
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
    let mut texture = texture(rng, Pattern::Speckle, colors, 0.010, 0.45);
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
    Blueprint {
        name: "ceramic_bear",
        class: "ceramic bear",
        material: "ceramic",
        solid: ellipsoid_union(&blobs, FIGURE_CELL_M),
        void: None,
        hollow: HollowKind::Solid,
        sphere_radius: None,
        texture,
    }
}

fn toy_robot(rng: &mut StageRng, size: f64) -> Blueprint {
    let s = uniform(rng, 0.9, 1.15) * size;
    let block =
        |min: [f64; 3], max: [f64; 3]| Cuboid::new(DVec3::from_array(min) * s, DVec3::from_array(max) * s);
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
    let mut texture = texture(rng, Pattern::Plain, colors, 0.02, 0.3);
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
    Blueprint {
        name: "toy_robot",
        class: "plastic toy robot",
        material: "plastic",
        solid: cuboid_union(&boxes, 0.008),
        void: None,
        hollow: HollowKind::Solid,
        sphere_radius: None,
        texture,
    }
}

fn place(blueprint: Blueprint, p_w: DVec2, yaw: f64, rng: &mut StageRng) -> TruthObject {
    let material = draw_material(blueprint.material, rng);
    let density = material.density.value.best;
    // The catalogue's shapes enclose volume whatever the seed draws; a test goes over many seeds.
    let mass_a = mass_properties(&blueprint, density).expect("an asset of the catalogue has mass");
    // A → B: the origin moves to the centre of mass and the yaw goes into the geometry.
    let turn = DQuat::from_rotation_z(yaw);
    let com_a = mass_a.com();
    let x_ba = DPose3::from_parts(-(turn * com_a), turn);
    let rotation = DMat3::from_quat(turn);
    let inertia = rotation * mass_a.inertia() * rotation.transpose();
    let mass =
        MassProperties::new(mass_a.mass(), DVec3::ZERO, inertia).expect("turning keeps the inertia valid");
    let volume = match blueprint.sphere_radius {
        Some(r) => 4.0 / 3.0 * std::f64::consts::PI * r.powi(3),
        None => blueprint.solid.mesh.volume(),
    };
    let mut mesh = blueprint.solid.mesh.transformed(&x_ba);
    mesh.colors = vertex_colors(&blueprint.solid.mesh, &blueprint.texture);
    let hollow = match blueprint.hollow {
        HollowKind::Solid => Hollow::Solid,
        HollowKind::Vessel(wall_m) => Hollow::Vessel { wall_m },
        HollowKind::Shell(wall_m) => Hollow::Shell { wall_m, wall_density: density },
    };
    TruthObject {
        name: blueprint.name.to_owned(),
        class: blueprint.class.to_owned(),
        material: with_effective_density(material, mass.mass() / volume),
        sphere_radius: blueprint.sphere_radius,
        mesh,
        parts: blueprint.solid.parts.iter().map(|p| p.transformed(&x_ba)).collect(),
        x_wb: DPose3::from_parts(DVec3::new(p_w.x, p_w.y, 0.0) + turn * com_a, DQuat::IDENTITY),
        texture: blueprint.texture,
        x_ab: x_ba.inverse(),
        hollow,
        mass,
    }
}

/// Mass properties in `A`: of the solid, or of the shell around the void.
fn mass_properties(blueprint: &Blueprint, density: f64) -> Result<MassProperties, InertiaError> {
    if let Some(radius) = blueprint.sphere_radius {
        let center = DVec3::Z * radius;
        let outer = sphere_mass_properties(center, radius, density)?;
        let HollowKind::Shell(wall) = blueprint.hollow else { return Ok(outer) };
        return without(&outer, &sphere_mass_properties(center, radius - wall, density)?);
    }
    let outer = polyhedron_mass_properties(&blueprint.solid.mesh, density)?;
    match &blueprint.void {
        Some(void) => without(&outer, &polyhedron_mass_properties(void, density)?),
        None => Ok(outer),
    }
}

/// What is left of a body when a part inside it is taken away (parallel-axis theorem).
fn without(whole: &MassProperties, part: &MassProperties) -> Result<MassProperties, InertiaError> {
    let mass = whole.mass() - part.mass();
    let com = (whole.com() * whole.mass() - part.com() * part.mass()) / mass;
    let about = |m: &MassProperties| {
        let d = m.com() - com;
        let square = DMat3::from_diagonal(DVec3::splat(d.length_squared()));
        m.inertia() + (square - DMat3::from_cols(d * d.x, d * d.y, d * d.z)) * m.mass()
    };
    MassProperties::new(mass, com, about(whole) - about(part))
}

fn vertex_colors(mesh_a: &Mesh, texture: &Texture) -> Vec<[u8; 3]> {
    let mut normals = vec![DVec3::ZERO; mesh_a.vertices.len()];
    for t in 0..mesh_a.triangles.len() {
        let [a, b, c] = mesh_a.corners(t);
        let n = (b - a).cross(c - a);
        mesh_a.triangles[t].iter().for_each(|&i| normals[i as usize] += n);
    }
    mesh_a
        .vertices
        .iter()
        .zip(&normals)
        .map(|(v, n)| texture.srgb(v.as_vec3(), n.normalize_or_zero().as_vec3(), 0.004))
        .collect()
}

//! Turned dishware: vessels with true walls and cavities, and a bottle.

use super::blueprint::{AssetBlueprint, SEGMENTS};
use crate::random::{pick, uniform};
use crate::shapes::{Handle, lathe_solid, lathe_vessel};
use crate::texture::{Pattern, Spot, Texture};
use glamx::DVec2;
use sms_core::StageRng;

/// Facets around a vessel. Each gives one convex piece per band of the wall, which costs simulation time.
const VESSEL_SEGMENTS: usize = 24;

const GLAZES: [([u8; 3], [u8; 3]); 5] = [
    ([228, 222, 206], [48, 84, 140]),
    ([196, 74, 52], [238, 220, 190]),
    ([70, 132, 120], [226, 222, 200]),
    ([226, 178, 72], [120, 60, 36]),
    ([92, 70, 128], [222, 206, 226]),
];

pub(super) fn bowl(rng: &mut StageRng, size: f64) -> AssetBlueprint {
    let (rim, height) = (uniform(rng, [0.065, 0.08]) * size, uniform(rng, [0.05, 0.06]) * size);
    let wall = uniform(rng, [0.0045, 0.0055]);
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
    let solid = lathe_vessel(&outer, &inner, VESSEL_SEGMENTS, None);
    let texture = Texture::drawn(rng, Pattern::Bands, glaze, 0.022, 0.8);
    AssetBlueprint::new("bowl", "ceramic bowl", "ceramic", solid, texture).open(wall)
}

pub(super) fn plate(rng: &mut StageRng, size: f64) -> AssetBlueprint {
    let rim = uniform(rng, [0.075, 0.09]) * size;
    let (height, wall, floor) = (uniform(rng, [0.020, 0.026]), 0.005, 0.006);
    let outer = [(0.58 * rim, 0.0), (0.64 * rim, floor), (0.84 * rim, 0.62 * height), (rim, height)];
    let inner = [(0.50 * rim, floor), (0.82 * rim, 0.62 * height + wall), (rim - 0.002, height + 0.8 * wall)];
    let glaze = pick(rng, &GLAZES);
    let solid = lathe_vessel(&outer, &inner, VESSEL_SEGMENTS, None);
    let texture = Texture::drawn(rng, Pattern::Bands, glaze, 0.008, 0.8);
    AssetBlueprint::new("plate", "ceramic plate", "ceramic", solid, texture).open(wall)
}

pub(super) fn mug(rng: &mut StageRng, size: f64) -> AssetBlueprint {
    let (radius, height) = (uniform(rng, [0.038, 0.044]) * size, uniform(rng, [0.085, 0.10]) * size);
    let (wall, floor) = (uniform(rng, [0.0042, 0.005]), 0.007);
    let band = 0.1 * height;
    let low = uniform(rng, [0.2, 0.26]) * height;
    let high = uniform(rng, [0.68, 0.74]) * height;
    let z = [0.003, floor, low, low + band, high, high + band, height - 0.002];
    let mut outer: Vec<_> = z.iter().map(|&z| (radius, z)).collect();
    outer[0] = (radius - 0.002, 0.0);
    let mut inner: Vec<_> = z[1..].iter().map(|&z| (radius - wall, z)).collect();
    outer.push((radius - 0.001, height));
    inner.push((radius - wall + 0.001, height));
    let handle = Handle { low_band: 2, high_band: 4, reach: uniform(rng, [0.026, 0.032]), thickness: 0.0085 };
    let glaze = pick(rng, &GLAZES);
    let solid = lathe_vessel(&outer, &inner, VESSEL_SEGMENTS, Some(handle));
    let texture = Texture::drawn(rng, Pattern::Bands, glaze, (height / 2.6) as f32, 0.8);
    AssetBlueprint::new("mug", "ceramic mug", "ceramic", solid, texture).open(wall)
}

pub(super) fn vase(rng: &mut StageRng, size: f64) -> AssetBlueprint {
    let (height, belly) = (uniform(rng, [0.14, 0.19]) * size, uniform(rng, [0.042, 0.052]) * size);
    let (neck, wall, floor) = (uniform(rng, [0.018, 0.024]) * size, 0.005, 0.010);
    let base = 0.7 * belly;
    let bands = 8;
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
    let solid = lathe_vessel(&outer, &inner, VESSEL_SEGMENTS, None);
    let texture = Texture::drawn(rng, pattern, glaze, 0.03, 0.8);
    AssetBlueprint::new("vase", "ceramic vase", "ceramic", solid, texture).open(wall)
}

/// A full food can: content and steel are one substance of their mean density.
pub(super) fn can(rng: &mut StageRng, size: f64) -> AssetBlueprint {
    let (radius, height) = (uniform(rng, [0.032, 0.037]) * size, uniform(rng, [0.09, 0.11]) * size);
    let rim = 0.0015;
    let profile = [
        (radius - 0.002, 0.0),
        (radius, 0.002),
        (radius, 0.005),
        (radius - rim, 0.007),
        (radius - rim, height - 0.007),
        (radius, height - 0.005),
        (radius, height - 0.002),
        (radius - 0.002, height),
    ];
    let colors = pick(
        rng,
        &[([190, 36, 34], [236, 232, 222]), ([42, 96, 60], [240, 220, 150]), ([40, 74, 130], [232, 200, 60])],
    );
    let texture = Texture::drawn(rng, Pattern::Bands, colors, (0.35 * height) as f32, 0.55);
    AssetBlueprint::new("can", "food can", "full_can", lathe_solid(&profile, SEGMENTS), texture)
}

pub(super) fn bottle(rng: &mut StageRng, size: f64) -> AssetBlueprint {
    let (radius, height) = (uniform(rng, [0.030, 0.037]) * size, uniform(rng, [0.15, 0.19]) * size);
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
    let wall = uniform(rng, [0.0014, 0.0022]);
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
    let mut texture = Texture::drawn(rng, Pattern::Bands, colors, 0.05, 0.65);
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
    AssetBlueprint::new("bottle", "plastic bottle", "plastic", lathe_solid(&profile, SEGMENTS), texture)
        .around(lathe_solid(&void, SEGMENTS).mesh, wall)
}

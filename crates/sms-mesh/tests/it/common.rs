//! Closed meshes of analytic shapes, in metres, standing on z = 0.
#![allow(dead_code, unreachable_pub, reason = "a module of fixtures; each user takes its own part")]

use sms_core::Mesh;
use sms_core::glamx::{DVec2, DVec3};
use std::collections::BTreeMap;

/// A solid of revolution about z with a closed outline (r, z).
pub fn lathe(outline: &[[f64; 2]], around: usize) -> Mesh {
    let mut mesh = Mesh::default();
    let id: Vec<Vec<u32>> = outline
        .iter()
        .map(|&[r, z]| {
            (0..around)
                .map(|k| {
                    if k > 0 && r == 0.0 {
                        return mesh.vertices.len() as u32 - 1;
                    }
                    let (sin, cos) = (std::f64::consts::TAU * k as f64 / around as f64).sin_cos();
                    mesh.vertices.push(DVec3::new(r * cos, r * sin, z));
                    mesh.vertices.len() as u32 - 1
                })
                .collect()
        })
        .collect();
    for i in 0..outline.len() {
        let j = (i + 1) % outline.len();
        for k in 0..around {
            let l = (k + 1) % around;
            for t in [[id[i][k], id[i][l], id[j][k]], [id[j][k], id[i][l], id[j][l]]] {
                if t[0] != t[1] && t[1] != t[2] && t[2] != t[0] {
                    mesh.triangles.push(t);
                }
            }
        }
    }
    outward(mesh)
}

fn outward(mut mesh: Mesh) -> Mesh {
    if mesh.volume() < 0.0 {
        for t in &mut mesh.triangles {
            t.swap(1, 2);
        }
    }
    assert!(mesh.is_closed_oriented());
    mesh
}

/// The union of boxes (corner, corner) as one surface.
pub fn blocks(boxes: &[([f64; 3], [f64; 3])]) -> Mesh {
    let lines: [Vec<f64>; 3] = std::array::from_fn(|k| {
        let mut at: Vec<f64> = boxes.iter().flat_map(|b| [b.0[k], b.1[k]]).collect();
        at.sort_by(f64::total_cmp);
        at.dedup();
        at
    });
    let cells: [usize; 3] = std::array::from_fn(|k| lines[k].len() - 1);
    let filled = |at: [isize; 3]| {
        (0..3).all(|k| at[k] >= 0 && (at[k] as usize) < cells[k])
            && boxes.iter().any(|b| {
                (0..3).all(|k| {
                    let middle = 0.5 * (lines[k][at[k] as usize] + lines[k][at[k] as usize + 1]);
                    b.0[k] < middle && middle < b.1[k]
                })
            })
    };
    let mut ids: BTreeMap<[usize; 3], u32> = BTreeMap::new();
    let mut mesh = Mesh::default();
    for z in 0..cells[2] {
        for y in 0..cells[1] {
            for x in 0..cells[0] {
                let at = [x as isize, y as isize, z as isize];
                if !filled(at) {
                    continue;
                }
                for axis in 0..3 {
                    for up in [0usize, 1] {
                        let mut to = at;
                        to[axis] += 2 * up as isize - 1;
                        if filled(to) {
                            continue;
                        }
                        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
                        let mut quad = [[0, 0], [1, 0], [1, 1], [0, 1]].map(|[du, dv]| {
                            let mut corner = [x, y, z];
                            corner[axis] += up;
                            corner[u] += du;
                            corner[v] += dv;
                            *ids.entry(corner).or_insert_with(|| {
                                mesh.vertices.push(DVec3::new(
                                    lines[0][corner[0]],
                                    lines[1][corner[1]],
                                    lines[2][corner[2]],
                                ));
                                mesh.vertices.len() as u32 - 1
                            })
                        });
                        if up == 0 {
                            quad.reverse();
                        }
                        mesh.triangles.push([quad[0], quad[1], quad[2]]);
                        mesh.triangles.push([quad[0], quad[2], quad[3]]);
                    }
                }
            }
        }
    }
    mesh
}

/// The zero level of a signed distance (negative inside) over a box, in cubes of size `cell`.
pub fn level_set(sdf: &dyn Fn(DVec3) -> f64, low: DVec3, high: DVec3, cell: f64) -> Mesh {
    let n = ((high - low) / cell).to_array().map(|v| v as usize + 2);
    let index = |x: usize, y: usize, z: usize| (z * n[1] + y) * n[0] + x;
    let center = |x: usize, y: usize, z: usize| low + DVec3::new(x as f64, y as f64, z as f64) * cell;
    let mut field = vec![0.0; n[0] * n[1] * n[2]];
    let each = |skip: usize| {
        (0..n[2] - skip)
            .flat_map(move |z| (0..n[1] - skip).flat_map(move |y| (0..n[0] - skip).map(move |x| [x, y, z])))
    };
    for [x, y, z] in each(0) {
        field[index(x, y, z)] = sdf(center(x, y, z));
    }
    let mut vertex = vec![u32::MAX; field.len()];
    let mut mesh = Mesh::default();
    for [x, y, z] in each(1) {
        let (mut sum, mut count) = (DVec3::ZERO, 0.0);
        for k in 0..8usize {
            for bit in [1usize, 2, 4].into_iter().filter(|bit| k & bit == 0) {
                let corner = |k: usize| [x + (k & 1), y + (k >> 1 & 1), z + (k >> 2)];
                let ([ax, ay, az], [bx, by, bz]) = (corner(k), corner(k | bit));
                let (fa, fb) = (field[index(ax, ay, az)], field[index(bx, by, bz)]);
                if (fa < 0.0) != (fb < 0.0) {
                    sum += center(ax, ay, az).lerp(center(bx, by, bz), fa / (fa - fb));
                    count += 1.0;
                }
            }
        }
        if count > 0.0 {
            vertex[index(x, y, z)] = mesh.vertices.len() as u32;
            mesh.vertices.push(sum / count);
        }
    }
    for at in each(1).filter(|at| at.iter().all(|&v| v > 0)) {
        for axis in 0..3 {
            let mut to = at;
            to[axis] += 1;
            let [a, b] = [at, to].map(|[x, y, z]| field[index(x, y, z)] < 0.0);
            if a == b {
                continue;
            }
            let cube = |du: usize, dv: usize| {
                let mut c = at;
                c[(axis + 1) % 3] -= du;
                c[(axis + 2) % 3] -= dv;
                vertex[index(c[0], c[1], c[2])]
            };
            let mut quad = [cube(1, 1), cube(0, 1), cube(0, 0), cube(1, 0)];
            if !a {
                quad.reverse();
            }
            mesh.triangles.extend([[quad[0], quad[1], quad[2]], [quad[0], quad[2], quad[3]]]);
        }
    }
    mesh
}

fn capsule(p: DVec3, a: DVec3, b: DVec3, r: f64) -> f64 {
    let t = ((p - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0);
    p.distance(a + (b - a) * t) - r
}

/// A round bowl, 16 cm wide, with a wall of `t`.
pub fn bowl(t: f64) -> Mesh {
    let (r, h, n) = (0.08, 0.055, 16);
    let arc = |r: f64, low: f64, k: usize| {
        let z = low + (h - low) * k as f64 / n as f64;
        [(r * r - (r - z).powi(2)).max(0.0).sqrt(), z]
    };
    let outer = (0..=n).map(|k| arc(r, 0.004, k));
    let inner = (0..=n).rev().map(|k| {
        let z = 0.004 + t + (h - 0.004 - t) * k as f64 / n as f64;
        [(((r - t).powi(2) - (r - z).powi(2)).max(0.0)).sqrt(), z]
    });
    let mut outline: Vec<[f64; 2]> = vec![[0.0, 0.004]];
    outline.extend(outer);
    outline.extend(inner);
    outline.push([0.0, 0.004 + t]);
    lathe(&outline, 48)
}

/// A cup without a handle, 8 cm wide and 9.5 cm high.
pub fn cup(t: f64) -> Mesh {
    let (r, h) = (0.04, 0.095);
    let outline =
        [[0.0, 0.0], [r, 0.0], [r, 0.5 * h], [r, h], [r - t, h], [r - t, 0.5 * h], [r - t, t], [0.0, t]];
    lathe(&outline, 48)
}

/// A cup with a handle.
pub fn mug() -> Mesh {
    let sdf = |p: DVec3| {
        let radial = DVec2::new(p.x, p.y).length();
        let outer = (radial - 0.04).max((p.z - 0.0475).abs() - 0.0475);
        let hollow = (radial - 0.036).max(0.005 - p.z);
        let ring = DVec2::new(DVec2::new(p.x - 0.042, p.z - 0.048).length() - 0.024, p.y).length() - 0.0055;
        outer.min(ring).max(-hollow)
    };
    level_set(&sdf, DVec3::new(-0.045, -0.045, -0.005), DVec3::new(0.08, 0.045, 0.1), 0.002)
}

/// A vase with a neck, 24 cm high.
pub fn vase(t: f64) -> Mesh {
    let radius = |z: f64| 0.035 + 0.03 * (std::f64::consts::PI * z / 0.24 * 1.3).sin().max(-0.5);
    let heights = (0..=24).map(|k| 0.24 * f64::from(k) / 24.0);
    let mut outline: Vec<[f64; 2]> = vec![[0.0, 0.0]];
    outline.extend(heights.clone().map(|z| [radius(z), z]));
    outline.extend(heights.rev().filter(|z| *z > t).map(|z| [radius(z) - t, z]));
    outline.extend([[radius(t) - t, t], [0.0, t]]);
    lathe(&outline, 40)
}

pub fn torus() -> Mesh {
    let outline: Vec<[f64; 2]> = (0..24)
        .map(|k| {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(k) / 24.0).sin_cos();
            [0.06 + 0.018 * cos, 0.018 + 0.018 * sin]
        })
        .collect();
    lathe(&outline, 48)
}

/// An open box with walls of `t`.
pub fn open_box([x, y, z]: [f64; 3], t: f64) -> Mesh {
    blocks(&[
        ([0.0, 0.0, 0.0], [x, y, t]),
        ([0.0, 0.0, 0.0], [t, y, z]),
        ([x - t, 0.0, 0.0], [x, y, z]),
        ([0.0, 0.0, 0.0], [x, t, z]),
        ([0.0, y - t, 0.0], [x, y, z]),
    ])
}

pub fn chair() -> Mesh {
    let leg = |x: f64, y: f64| ([x, y, 0.0], [x + 0.04, y + 0.04, 0.42]);
    blocks(&[
        leg(0.0, 0.0),
        leg(0.36, 0.0),
        leg(0.0, 0.36),
        leg(0.36, 0.36),
        ([0.0, 0.0, 0.40], [0.40, 0.40, 0.44]),
        ([0.0, 0.37, 0.40], [0.40, 0.40, 0.85]),
    ])
}

/// A standing figure of capsules.
pub fn figure() -> Mesh {
    let limbs = [
        (DVec3::new(0.0, 0.0, 0.09), DVec3::new(0.0, 0.0, 0.14), 0.028),
        (DVec3::new(0.0, 0.0, 0.19), DVec3::new(0.0, 0.0, 0.2), 0.022),
        (DVec3::new(0.015, 0.0, 0.09), DVec3::new(0.025, 0.0, 0.013), 0.013),
        (DVec3::new(-0.015, 0.0, 0.09), DVec3::new(-0.025, 0.0, 0.013), 0.013),
        (DVec3::new(0.03, 0.0, 0.155), DVec3::new(0.085, 0.0, 0.12), 0.01),
        (DVec3::new(-0.03, 0.0, 0.155), DVec3::new(-0.07, 0.03, 0.19), 0.01),
    ];
    let sdf = |p: DVec3| limbs.iter().map(|&(a, b, r)| capsule(p, a, b, r)).fold(f64::MAX, f64::min);
    level_set(&sdf, DVec3::new(-0.09, -0.04, -0.01), DVec3::new(0.105, 0.05, 0.23), 0.003)
}

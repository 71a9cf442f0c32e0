//! Exact orientation and in-sphere tests on [`DVec3`], with the sign conventions of this crate.

use glamx::DVec3;
use robust::Coord3D;

/// Corners of the face opposite each corner of a tetrahedron, counter-clockwise seen from outside it.
pub const FACES: [[usize; 3]; 4] = [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]];
/// The face across the edge from corner `k` to corner `k + 1` of each of these faces.
pub(crate) const ACROSS: [[u32; 3]; 4] = [[3, 1, 2], [2, 0, 3], [3, 0, 1], [1, 0, 2]];

fn coord(p: DVec3) -> Coord3D<f64> {
    Coord3D { x: p.x, y: p.y, z: p.z }
}

/// Returns the sign of the volume of tetrahedron (a, b, c, d): positive when `d` lies on the side of the normal (b − a)
/// × (c − a). It is zero exactly when the four points are coplanar.
pub(crate) fn orient(a: DVec3, b: DVec3, c: DVec3, d: DVec3) -> f64 {
    -robust::orient3d(coord(a), coord(b), coord(c), coord(d))
}

/// Returns whether three points are exactly collinear.
pub(crate) fn collinear(a: DVec3, b: DVec3, c: DVec3) -> bool {
    let flat = |i: usize, j: usize| {
        let at = |p: DVec3| robust::Coord { x: p[i], y: p[j] };
        robust::orient2d(at(a), at(b), at(c)) == 0.0
    };
    flat(0, 1) && flat(1, 2) && flat(2, 0)
}

/// Returns a positive value when `e` lies strictly inside the circumsphere of the positively oriented tetrahedron (a,
/// b, c, d).
pub(crate) fn in_sphere(a: DVec3, b: DVec3, c: DVec3, d: DVec3, e: DVec3) -> f64 {
    // The library uses the opposite orientation, hence the swap of the first two corners.
    robust::insphere(coord(b), coord(a), coord(c), coord(d), coord(e))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faces_across_an_edge_share_its_ends() {
        for (face, across) in FACES.iter().zip(ACROSS) {
            for k in 0..3 {
                let other = FACES[across[k] as usize];
                let ends = [face[(k + 1) % 3], face[k]];
                assert!((0..3).any(|m| [other[m], other[(m + 1) % 3]] == ends), "{face:?} {k}");
            }
        }
    }

    #[test]
    fn signs_are_as_documented() {
        let (a, b, c, d) = (DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z);
        assert!(orient(a, b, c, d) > 0.0);
        assert!(orient(a, b, c, -d) < 0.0);
        assert_eq!(orient(a, b, c, DVec3::new(0.3, 0.9, 0.0)), 0.0);
        assert!(in_sphere(a, b, c, d, DVec3::splat(0.5)) > 0.0);
        assert!(in_sphere(a, b, c, d, DVec3::splat(1.5)) < 0.0);
        assert_eq!(in_sphere(a, b, c, d, DVec3::splat(1.0)), 0.0);
        assert!(collinear(a, b, b * 3.0) && !collinear(a, b, c));
    }
}

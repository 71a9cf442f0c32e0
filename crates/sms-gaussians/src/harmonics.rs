//! Colour that depends on the viewing direction: real spherical harmonics of degrees 1 and 2, in the order and with the signs
//! of 3D Gaussian Splatting (Kerbl et al. 2023). The constant part is the colour itself.

use glamx::{Quat, Vec3};

/// Number of basis functions of degrees 1 and 2.
pub const BASIS: usize = 8;

/// Coefficients of one Gaussian: for each basis function its red, green and blue.
pub type Harmonics = [f32; 3 * BASIS];

/// A colour that is the same from all directions.
pub const CONSTANT: Harmonics = [0.0; 3 * BASIS];

/// √(3/4π).
const DEGREE_1: f32 = 0.488_602_5;
/// √(15/4π), √(5/16π) and √(15/16π).
const DEGREE_2: [f32; 3] = [1.092_548_4, 0.315_391_57, 0.546_274_2];

/// Returns the basis functions at the direction from the camera to a Gaussian, a vector of any length but zero.
#[inline(always)]
pub fn basis([x, y, z]: [f32; 3]) -> [f32; BASIS] {
    let square = x * x + y * y + z * z;
    let inverse = if square > 0.0 { 1.0 / square.sqrt() } else { 0.0 };
    let (x, y, z) = (x * inverse, y * inverse, z * inverse);
    let [c, c_zz, c_xx] = DEGREE_2;
    [
        -DEGREE_1 * y,
        DEGREE_1 * z,
        -DEGREE_1 * x,
        c * (x * y),
        -c * (y * z),
        c_zz * (2.0 * z * z - x * x - y * y),
        -c * (x * z),
        c_xx * (x * x - y * y),
    ]
}

/// Returns the difference to the constant colour that `coefficients` make in a direction with these basis functions.
#[inline(always)]
pub fn difference(coefficients: &Harmonics, basis: &[f32; BASIS]) -> [f32; 3] {
    let mut sum = [0.0; 3];
    for (k, value) in basis.iter().enumerate() {
        for c in 0..3 {
            sum[c] += value * coefficients[3 * k + c];
        }
    }
    sum
}

/// Returns the difference to the constant colour in the mean over the directions from which a surface with this outward normal is
/// seen, weighted by the cosine of the viewing angle: the first degrees of a clamped cosine lobe, 2/3 and 1/4 of their values along
/// the normal (Ramamoorthi and Hanrahan, SIGGRAPH 2001).
///
/// The data do not fix the constant colour by itself, since a surface is seen from one side only.
pub fn mean_difference(coefficients: &Harmonics, outward_w: [f32; 3]) -> [f32; 3] {
    let mut lobe = basis(outward_w.map(|v| -v));
    lobe[..3].iter_mut().for_each(|v| *v *= 2.0 / 3.0);
    lobe[3..].iter_mut().for_each(|v| *v *= 1.0 / 4.0);
    difference(coefficients, &lobe)
}

/// How rotated coefficients follow from those before: `rotated[j] = Σ m[j][k] · before[k]`.
pub type HarmonicsRotation = [[f32; BASIS]; BASIS];

/// Returns the change of the coefficients when the colours turn with `rotation`: the integral of each basis function times the
/// turned ones over the sphere, exact by the twelve corners of an icosahedron (a spherical 5-design; the products have degree 4).
pub fn rotation_of(rotation: Quat) -> HarmonicsRotation {
    let golden = (1.0 + 5f32.sqrt()) / 2.0;
    let share = 4.0 * std::f32::consts::PI / 12.0;
    let mut matrix = [[0.0; BASIS]; BASIS];
    for corner in 0..12 {
        let sign = |bit: usize| if corner & bit == 0 { 1.0 } else { -1.0 };
        let (a, b) = (sign(1), golden * sign(2));
        let direction = match corner / 4 {
            0 => Vec3::new(0.0, a, b),
            1 => Vec3::new(a, b, 0.0),
            _ => Vec3::new(b, 0.0, a),
        };
        let (after, before) =
            (basis(direction.to_array()), basis((rotation.inverse() * direction).to_array()));
        for (row, after) in matrix.iter_mut().zip(after) {
            row.iter_mut().zip(before).for_each(|(m, before)| *m += share * after * before);
        }
    }
    matrix
}

/// Returns the coefficients after a rotation.
pub fn rotated(coefficients: &Harmonics, rotation: &HarmonicsRotation) -> Harmonics {
    std::array::from_fn(|i| (0..BASIS).map(|k| rotation[i / 3][k] * coefficients[3 * k + i % 3]).sum())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn turned_colours_look_the_same_from_turned_directions(
            coefficients in prop::array::uniform24(-1f32..1.0),
            q in prop::array::uniform4(-1f32..1.0),
            d in prop::array::uniform3(-1f32..1.0),
        ) {
            let (q, d) = (Quat::from_array(q), Vec3::from_array(d));
            prop_assume!(q.length() > 0.1 && d.length() > 0.1);
            let q = q.normalize();
            let turned = rotated(&coefficients, &rotation_of(q));
            let before = difference(&coefficients, &basis(d.to_array()));
            let after = difference(&turned, &basis((q * d).to_array()));
            prop_assert!((0..3).all(|c| (before[c] - after[c]).abs() < 1e-5), "{before:?} {after:?}");
        }
    }

    #[test]
    fn the_mean_is_that_over_the_hemisphere() {
        let coefficients: Harmonics = std::array::from_fn(|i| ((7 * i) % 11) as f32 / 11.0 - 0.4);
        let outward = Vec3::new(0.3, -0.5, 0.8).normalize();
        // A spiral of directions that are evenly spread over the sphere.
        let (mut sum, mut weight) = ([0.0f64; 3], 0.0);
        for i in 0..100_000 {
            let z = 1.0 - (2 * i + 1) as f32 / 100_000.0;
            let turn = i as f32 * 2.399_963;
            let towards_camera = Vec3::new(turn.cos(), turn.sin(), 0.0) * (1.0 - z * z).sqrt() + Vec3::Z * z;
            let cosine = f64::from(towards_camera.dot(outward).max(0.0));
            let seen = difference(&coefficients, &basis((-towards_camera).to_array()));
            (0..3).for_each(|c| sum[c] += cosine * f64::from(seen[c]));
            weight += cosine;
        }
        let mean = mean_difference(&coefficients, outward.to_array());
        assert!((0..3).all(|c| (sum[c] / weight - f64::from(mean[c])).abs() < 1e-3), "{sum:?} {mean:?}");
    }

    #[test]
    fn the_camera_at_a_gaussian_sees_its_constant_colour() {
        assert_eq!(difference(&[1.0; 3 * BASIS], &basis([0.0; 3])), [0.0; 3]);
    }
}

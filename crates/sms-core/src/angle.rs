//! Equivalent angles.

use std::f64::consts::TAU;

/// Returns the equivalent angle in (−π, π], radians.
pub fn wrapped_angle(angle: f64) -> f64 {
    let turned = angle.rem_euclid(TAU);
    if turned > 0.5 * TAU { turned - TAU } else { turned }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::f64::consts::PI;

    #[test]
    fn half_a_turn_is_positive() {
        assert_eq!((wrapped_angle(PI), wrapped_angle(-PI), wrapped_angle(0.0)), (PI, PI, 0.0));
    }

    proptest! {
        #[test]
        fn it_points_the_same_way_and_is_the_shortest(angle in -50.0..50.0f64) {
            let wrapped = wrapped_angle(angle);
            prop_assert!(wrapped > -PI && wrapped <= PI);
            let (a, b) = (angle.sin_cos(), wrapped.sin_cos());
            prop_assert!((a.0 - b.0).abs() < 1e-12 && (a.1 - b.1).abs() < 1e-12);
        }
    }
}

//! A multirotor as a rigid body with legs.

use super::VehicleError;
use glamx::{DMat3, DPose3, DVec3};
use serde::{Deserialize, Serialize};
use sms_core::{InertiaError, MassProperties, Material, Mesh};
use sms_scene::{Body, BodyKind, BodyShape};

/// The built-in vehicle's file.
const PUBLISHED: &str = include_str!("quadrotor.toml");

/// A propeller of a vehicle.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Rotor {
    /// Centre of the disk in the vehicle's frame `V`, metres.
    pub p_v: DVec3,
    /// Radius, metres.
    pub radius: f64,
}

/// A multirotor. SI units, in the vehicle's frame `V`: z up, origin at the centre of mass, principal axes of inertia
/// along the axes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Quadrotor {
    /// Name.
    pub name: String,
    /// Mass, kg.
    pub mass: f64,
    /// Principal moments of inertia about x, y and z, kg·m².
    pub inertia: DVec3,
    /// Radius of the propellers, metres.
    pub rotor_radius: f64,
    /// Centres of the propellers, metres.
    pub rotors: Vec<DVec3>,
    /// Half extents of the body's box, metres.
    pub body_half: DVec3,
    /// Lowest points of the legs, metres. Legs extend up to the height of the propellers.
    pub feet: Vec<DVec3>,
    /// Half the width of a leg, metres.
    pub foot_half: f64,
}

impl Default for Quadrotor {
    /// The paper's vehicle.
    fn default() -> Self {
        Self::from_toml(PUBLISHED).expect("the built-in vehicle is valid")
    }
}

impl Quadrotor {
    /// Reads and checks a vehicle.
    ///
    /// # Errors
    /// [`VehicleError::Vehicle`] when the text is malformed or the vehicle is impossible: values that are not positive,
    /// an impossible inertia, overlapping propellers, feet above the body's bottom or on one line.
    pub fn from_toml(text: &str) -> Result<Self, VehicleError> {
        let vehicle: Self = toml::from_str(text).map_err(|e| VehicleError::Vehicle(e.to_string()))?;
        vehicle.check()?;
        Ok(vehicle)
    }

    fn check(&self) -> Result<(), VehicleError> {
        let refuse = |why: String| Err(VehicleError::Vehicle(why));
        for (name, value) in [
            ("mass", self.mass),
            ("rotor_radius", self.rotor_radius),
            ("foot_half", self.foot_half),
            ("body_half", self.body_half.min_element()),
            ("inertia", self.inertia.min_element()),
        ] {
            if !(value > 0.0 && value.is_finite()) {
                return refuse(format!("`{name}` is {value}, but must be positive"));
            }
        }
        if let Err(error) = self.mass_properties() {
            return refuse(error.to_string());
        }
        if self.rotors.is_empty() {
            return refuse("it has no propellers".to_owned());
        }
        for (i, p) in self.rotors.iter().enumerate() {
            for q in &self.rotors[..i] {
                if p.distance(*q) < 2.0 * self.rotor_radius {
                    return refuse(format!("propellers at {p} and {q} overlap"));
                }
            }
        }
        if self.feet.len() < 3 {
            return refuse("it needs three feet to stand".to_owned());
        }
        if self.feet.iter().any(|f| f.z >= -self.body_half.z) {
            return refuse("a foot ends above the bottom of the body".to_owned());
        }
        let area = |k: usize| {
            (self.feet[k] - self.feet[0]).truncate().perp_dot((self.feet[1] - self.feet[0]).truncate())
        };
        if (2..self.feet.len()).all(|k| area(k).abs() < 1e-6) {
            return refuse("its feet stand on one line".to_owned());
        }
        Ok(())
    }

    /// Mass and inertia about the centre of mass, in `V`.
    ///
    /// # Errors
    /// [`InertiaError`] for impossible values, which reading a vehicle refuses.
    pub fn mass_properties(&self) -> Result<MassProperties, InertiaError> {
        MassProperties::new(self.mass, DVec3::ZERO, DMat3::from_diagonal(self.inertia))
    }

    /// The propellers.
    pub fn propellers(&self) -> Vec<Rotor> {
        self.rotors.iter().map(|&p_v| Rotor { p_v, radius: self.rotor_radius }).collect()
    }

    /// Thrust of each propeller (N) when hovering under `gravity` m/s².
    pub fn hover_thrusts(&self, gravity: f64) -> Vec<f64> {
        vec![self.mass * gravity / self.rotors.len() as f64; self.rotors.len()]
    }

    /// Height of the centre of mass above the feet, metres.
    pub fn standing_height(&self) -> f64 {
        -self.feet.iter().map(|f| f.z).fold(f64::INFINITY, f64::min)
    }

    /// Radius (metres) of the circle about the centre that contains propellers and feet, in the top view.
    pub fn reach(&self) -> f64 {
        let rotors = self.rotors.iter().map(|p| p.truncate().length() + self.rotor_radius);
        let feet = self.feet.iter().map(|p| p.truncate().length() + self.foot_half);
        rotors.chain(feet).fold(0.0, f64::max)
    }

    /// Convex collision solids in `V`: the body's box and a post for each leg.
    pub fn solids(&self) -> Vec<Mesh> {
        let top = self.rotors.iter().map(|p| p.z).fold(0.0, f64::max);
        let leg = |foot: &DVec3| {
            let half_length = 0.5 * (top - foot.z);
            let center = foot.with_z(foot.z + half_length);
            Mesh::cuboid(DVec3::new(self.foot_half, self.foot_half, half_length))
                .transformed(&DPose3::from_translation(center))
        };
        std::iter::once(Mesh::cuboid(self.body_half)).chain(self.feet.iter().map(leg)).collect()
    }

    /// Returns the vehicle as a dynamic body of a scene, without a visual mesh. Simulation requires
    /// [`Quadrotor::mass_properties`]; rendering does not.
    pub fn body(&self, name: &str, x_wv: DPose3, mass: Option<MassProperties>, material: Material) -> Body {
        Body {
            name: name.to_owned(),
            label: 0,
            description: self.name.clone(),
            kind: BodyKind::Dynamic,
            x_wb: x_wv,
            shape: BodyShape::Hulls { hulls: self.solids() },
            visual: Mesh::default(),
            texture: None,
            mass,
            material,
            color: [60, 60, 65],
            observed_share: 1.0,
            fit_se_m: 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_built_in_vehicle_is_the_published_one() {
        let vehicle = Quadrotor::default();
        assert_eq!((vehicle.mass, vehicle.rotor_radius, vehicle.rotors.len()), (1.182, 0.0685, 4));
        let total: f64 = vehicle.hover_thrusts(9.81).iter().sum();
        assert!((total - 1.182 * 9.81).abs() < 1e-12);
        assert_eq!(vehicle.standing_height(), 0.05);
        // The stated inertia follows from the stated masses: a box, and four points at mid height.
        let (box_mass, motor) = (0.942, 0.06);
        let h = vehicle.body_half;
        let boxed =
            box_mass / 3.0 * DVec3::new(h.y * h.y + h.z * h.z, h.z * h.z + h.x * h.x, h.x * h.x + h.y * h.y);
        let across = vehicle.rotors[0].with_z(0.0);
        let d2 = across * across;
        let motors = 4.0 * motor * DVec3::new(d2.y + d2.z, d2.z + d2.x, d2.x + d2.y);
        assert!((vehicle.inertia - boxed - motors).abs().max_element() < 1e-5, "{}", boxed + motors);
    }

    #[test]
    fn its_solids_are_convex_and_stand_on_the_feet() {
        let vehicle = Quadrotor::default();
        let solids = vehicle.solids();
        assert_eq!(solids.len(), 5);
        let lowest = solids.iter().flat_map(|m| &m.vertices).map(|v| v.z).fold(f64::INFINITY, f64::min);
        assert!((lowest + vehicle.standing_height()).abs() < 1e-12);
    }

    #[test]
    fn vehicles_that_cannot_be_are_refused_with_the_reason() {
        for (from, to, why) in [
            ("mass = 1.182", "mass = -1.0", "mass"),
            ("[0.00403, 0.00491, 0.00794]", "[0.001, 0.001, 0.01]", "moments"),
            ("rotor_radius = 0.0685", "rotor_radius = 0.2", "overlap"),
            ("body_half = [0.08, 0.06, 0.04]", "body_half = [0.08, 0.06, 0.06]", "foot"),
            ("foot_half", "feet_half", "feet_half"),
        ] {
            let error = Quadrotor::from_toml(&PUBLISHED.replace(from, to)).unwrap_err().to_string();
            assert!(error.contains(why), "{error}");
        }
    }
}

//! Transformations from the world to the frames of autopilots.

use glamx::{DVec2, DVec3};
use serde::{Deserialize, Serialize};

/// WGS 84: equatorial radius (metres) and squared eccentricity.
const EQUATOR_M: f64 = 6_378_137.0;
const ECCENTRICITY2: f64 = 6.694_379_990_141_316e-3;

/// A position on Earth, WGS 84.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Geodetic {
    /// Latitude, degrees.
    pub latitude_deg: f64,
    /// Longitude, degrees.
    pub longitude_deg: f64,
    /// Height above mean sea level, metres.
    pub altitude_m: f64,
}

/// Pose of the vehicle at arming: the origin of the autopilot's local frame (north, east, down).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Home {
    /// The vehicle's centre of mass at arming, in the world, metres.
    pub home_w: DVec3,
    /// Direction of east in the world: rotation about z from the world's x, radians.
    pub east_yaw: f64,
    /// The same place on Earth, if known.
    pub geodetic: Option<Geodetic>,
}

impl Home {
    /// A vector of the world in north, east, down axes.
    pub fn vector_to_ned(&self, v_w: DVec3) -> DVec3 {
        let enu = DVec2::from_angle(-self.east_yaw).rotate(v_w.truncate());
        DVec3::new(enu.y, enu.x, -v_w.z)
    }

    /// A point of the world in the local frame: metres north, east and down from home.
    pub fn to_ned(&self, p_w: DVec3) -> DVec3 {
        self.vector_to_ned(p_w - self.home_w)
    }

    /// The inverse of [`Home::to_ned`].
    #[cfg(test)]
    pub(crate) fn world_of_ned(&self, p_ned: DVec3) -> DVec3 {
        let enu = DVec2::new(p_ned.y, p_ned.x);
        self.home_w + DVec2::from_angle(self.east_yaw).rotate(enu).extend(-p_ned.z)
    }

    /// The heading (clockwise from north) of a rotation about the world's z from its x; radians in (−π, π].
    pub fn heading(&self, yaw: f64) -> f64 {
        let turn = std::f64::consts::TAU;
        let h = (0.25 * turn - (yaw - self.east_yaw)).rem_euclid(turn);
        if h > 0.5 * turn { h - turn } else { h }
    }

    /// Latitude and longitude (degrees) of a point and its height above home (metres); `None` if home is unknown.
    pub fn to_geodetic(&self, p_w: DVec3) -> Option<(f64, f64, f64)> {
        let home = self.geodetic?;
        let ned = self.to_ned(p_w);
        let (meridian, parallel) = radii(home);
        let latitude = home.latitude_deg + (ned.x / meridian).to_degrees();
        let longitude = home.longitude_deg + (ned.y / parallel).to_degrees();
        Some((latitude, longitude, -ned.z))
    }

    /// The inverse of [`Home::to_geodetic`]; `None` if home is unknown.
    #[cfg(test)]
    pub(crate) fn world_of_geodetic(
        &self,
        latitude_deg: f64,
        longitude_deg: f64,
        above_home_m: f64,
    ) -> Option<DVec3> {
        let home = self.geodetic?;
        let (meridian, parallel) = radii(home);
        let north = (latitude_deg - home.latitude_deg).to_radians() * meridian;
        let east = (longitude_deg - home.longitude_deg).to_radians() * parallel;
        Some(self.world_of_ned(DVec3::new(north, east, -above_home_m)))
    }
}

/// Metres per radian of latitude and of longitude at home. Over the few metres of an approach the ellipsoid is flat to
/// micrometres.
fn radii(home: Geodetic) -> (f64, f64) {
    let (sin, cos) = home.latitude_deg.to_radians().sin_cos();
    let w2 = 1.0 - ECCENTRICITY2 * sin * sin;
    let normal = EQUATOR_M / w2.sqrt();
    let meridian = normal * (1.0 - ECCENTRICITY2) / w2;
    (meridian + home.altitude_m, (normal + home.altitude_m) * cos)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const SITE: Geodetic = Geodetic { latitude_deg: 47.397_742, longitude_deg: 8.545_594, altitude_m: 488.0 };

    #[test]
    fn axes_are_where_they_should_be() {
        // East along the world's y.
        let home = Home {
            home_w: DVec3::new(1.0, 2.0, 0.05),
            east_yaw: 0.5 * std::f64::consts::PI,
            geodetic: Some(SITE),
        };
        let east = home.to_ned(DVec3::new(1.0, 5.0, 0.05));
        assert!(east.distance(DVec3::new(0.0, 3.0, 0.0)) < 1e-12, "{east}");
        let north = home.to_ned(DVec3::new(-1.0, 2.0, 1.05));
        assert!(north.distance(DVec3::new(2.0, 0.0, -1.0)) < 1e-12, "{north}");
        // A vehicle that faces the world's y faces east; one that faces −x faces north.
        let quarter = 0.5 * std::f64::consts::PI;
        assert!((home.heading(quarter) - quarter).abs() < 1e-12 && home.heading(2.0 * quarter).abs() < 1e-12);
        let (latitude, longitude, above) = home.to_geodetic(DVec3::new(-99.0, 2.0, 3.05)).unwrap();
        // 100 m north at 47.4°: a degree of latitude is 111.18 km (and 8 ppm more at 488 m).
        assert!(
            ((latitude - SITE.latitude_deg) * 111_180.0 - 100.0).abs() < 0.05 && (above - 3.0).abs() < 1e-12
        );
        assert!((longitude - SITE.longitude_deg).abs() < 1e-12);
    }

    proptest! {
        #[test]
        fn frames_come_back_and_keep_lengths(
            x in -5.0..5.0f64, y in -5.0..5.0f64, z in -1.0..3.0f64, yaw in -7.0..7.0f64, east in -7.0..7.0f64,
        ) {
            let home = Home { home_w: DVec3::new(0.3, -1.0, 0.05), east_yaw: east, geodetic: Some(SITE) };
            let p_w = DVec3::new(x, y, z);
            let ned = home.to_ned(p_w);
            prop_assert!(home.world_of_ned(ned).distance(p_w) < 1e-12);
            prop_assert!((ned.length() - p_w.distance(home.home_w)).abs() < 1e-12);
            let (latitude, longitude, above) = home.to_geodetic(p_w).unwrap();
            prop_assert!(home.world_of_geodetic(latitude, longitude, above).unwrap().distance(p_w) < 1e-7);
            // The heading is that of the vehicle's forward axis in NED.
            let forward = home.vector_to_ned(DVec2::from_angle(yaw).extend(0.0));
            let difference = forward.y.atan2(forward.x) - home.heading(yaw);
            prop_assert!(difference.sin().abs() < 1e-9 && difference.cos() > 0.0);
        }
    }
}

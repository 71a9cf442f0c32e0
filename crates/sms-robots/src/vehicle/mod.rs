//! Flying vehicles.

mod flight;
mod quadrotor;

pub use flight::{BezierPath, Flight, FlightSettings};
pub use quadrotor::{Quadrotor, Rotor};

/// Error of a vehicle or its flight.
#[derive(Debug, thiserror::Error)]
pub enum VehicleError {
    /// A setting is out of range.
    #[error("{name} is {value}, but must be {must}")]
    Setting {
        /// Key of the setting.
        name: &'static str,
        /// Its value.
        value: f64,
        /// The allowed range.
        must: &'static str,
    },
    /// A vehicle file is unreadable, or describes an impossible vehicle.
    #[error("the vehicle cannot be used: {0}")]
    Vehicle(String),
}

impl VehicleError {
    /// Refuses values that are not positive and finite.
    pub(crate) fn positive(name: &'static str, value: f64) -> Result<(), Self> {
        if value > 0.0 && value.is_finite() {
            return Ok(());
        }
        Err(Self::Setting { name, value, must: "positive" })
    }
}

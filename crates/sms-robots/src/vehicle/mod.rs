//! Flying vehicles.

mod error;
mod flight;
mod quadrotor;

pub use error::VehicleError;
pub use flight::{BezierPath, Flight, FlightSettings};
pub use quadrotor::{Quadrotor, Rotor};

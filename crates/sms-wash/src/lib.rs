//! Propeller wash on rigid bodies behind one trait, [`Wash`]: the forces of the propellers' air on the bodies below a
//! vehicle.
//!
//! | model | content | purpose |
//! |---|---|---|
//! | `disk` | uniform tubes of momentum ([`StreamWash::disk`]) | closed forms |
//! | `jet` | turbulent round jets that merge ([`StreamWash::jet`], [`RoundJet`]) | screening |
//! | `sph` | smoothed-particle hydrodynamics ([`SphWash`]) | refinement and the final score |
//!
//! [`WashSettings`] selects one. All are calibrated by momentum theory ([`ActuatorDisk`]; the paper's appendix
//! "Quadrotor Propeller Model") and act on the same surfaces, unions of convex parts ([`BodySurface`]). Skin friction
//! is neglected: the air loses the component of its momentum along a surface's normal.
//!
//! The vehicle is a [`sms_robots::Quadrotor`], its approach a [`sms_robots::Flight`].
//!
//! ```
//! use glamx::{DPose3, DVec3};
//! use sms_robots::Rotor;
//! use sms_wash::{BodyState, BodySurface, StreamSettings, StreamWash, VehicleState, Wash, Wrench};
//!
//! // A quadrotor of 11.6 N hovers half a metre above a table.
//! let table = BodySurface::cuboid(DVec3::new(0.5, 0.5, 0.02))?;
//! let mut wash = StreamWash::jet(vec![table], StreamSettings::default())?;
//! let rotors = [(0.1, 0.1), (0.1, -0.1), (-0.1, 0.1), (-0.1, -0.1)]
//!     .map(|(x, y)| Rotor { p_v: DVec3::new(x, y, 0.0), radius: 0.0685 });
//! let vehicle = VehicleState {
//!     x_wv: DPose3::from_translation(DVec3::new(0.0, 0.0, 0.52)),
//!     v_w: DVec3::ZERO,
//!     rotors: &rotors,
//!     thrusts: &[2.9; 4],
//! };
//! let mut wrenches = [Wrench::default()];
//! wash.step(0.0025, &vehicle, &[BodyState::at_rest(DPose3::IDENTITY)], &mut wrenches);
//! assert!((wrenches[0].force_w.z / -11.6 - 1.0).abs() < 0.02, "the table carries the vehicle");
//! # Ok::<(), sms_wash::WashError>(())
//! ```

mod disk;
mod error;
mod jet;
mod model;
mod sph;
mod stream;
mod surface;
mod wash;

pub use disk::{ActuatorDisk, Emission, Emitted};
pub use error::WashError;
pub use jet::{RoundJet, SPREADING_RATE};
pub use model::{WashModel, WashSettings};
pub use sph::{EmissionPattern, SmoothingKernel, SphSettings, SphWash};
pub use stream::{StreamSettings, StreamWash};
pub use surface::{BodySurface, SurfaceHit};
pub use wash::{BodyState, VehicleState, Wash, Wrench};

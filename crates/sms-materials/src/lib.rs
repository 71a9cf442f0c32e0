//! Material properties of objects, with intervals and sources.
//!
//! Four sources, strongest first: the user's own values ([`Overrides`]), the estimate of a vision-language model
//! ([`Estimate`]), the handbook table by material class or by words in the object's name and description
//! ([`MaterialTable`]), and a stated prior. Every value keeps its interval and its source, so that planning can sample the
//! uncertainty.
//!
//! The mass of an object is density × fill factor × volume of its mesh. The density is the material's own; the fill factor
//! is 1 for solids and for meshes of walls, and less for objects that are hollow inside.
//!
//! ```
//! use sms_core::{PropertySource, Warnings};
//! use sms_materials::{MaterialTable, ObjectQuery, assign};
//! let mug = ObjectQuery { name: "object_01".into(), description: "blue coffee mug".into(), ..Default::default() };
//! let materials = assign(&[mug], &MaterialTable::builtin(), None, &Warnings::new())?;
//! assert_eq!(materials[0].class, "ceramic");
//! assert_eq!(materials[0].friction.source, PropertySource::Table);
//! assert!(materials[0].effective_density() < materials[0].density.value.best, "a mug is hollow");
//! # Ok::<(), sms_core::CoreError>(())
//! ```

mod assign;
mod choices;
mod estimate;
mod overrides;
mod table;
mod unusual;

pub use assign::{ObjectQuery, assign, without_override};
pub use choices::{ClassChoice, ClassOrigin, class_choices};
pub use estimate::Estimate;
pub use overrides::{ObjectOverride, OverrideInterval, OverrideValue, Overrides};
pub use table::{ClassEntry, MaterialTable, Range};
pub use unusual::MATERIAL_UNUSUAL;

//! Material properties of objects, with intervals and sources.
//!
//! Three sources, strongest first: the user's own file ([`Overrides`]), the handbook table by material class or by words
//! in the object's name and description ([`MaterialTable`]), and a stated prior. Every value keeps its interval and who
//! said it, so that planning can sample what is not known.
//!
//! ```
//! use sms_core::{PropertySource, Warnings};
//! use sms_materials::{MaterialTable, ObjectQuery, assign};
//! let mug = ObjectQuery { name: "object_01".into(), description: "blue coffee mug".into(), ..Default::default() };
//! let materials = assign(&[mug], &MaterialTable::builtin(), None, &Warnings::new())?;
//! assert_eq!(materials[0].class, "ceramic");
//! assert_eq!(materials[0].friction.source, PropertySource::Table);
//! # Ok::<(), sms_core::CoreError>(())
//! ```

mod assign;
mod overrides;
mod store;
mod table;

pub use assign::{ObjectQuery, assign};
pub use overrides::{ObjectOverride, OverrideValue, Overrides};
pub use store::{load_materials, save_materials};
pub use table::{ClassEntry, MaterialTable, Range};

//! Validated estimates of objects in a scene by a vision-language model.
//!
//! The paper (section Materialize) shows a model each object in a picture with its box, and asks for its material,
//! density, friction, restitution, Young's modulus and Poisson's ratio. This crate asks any server with OpenAI's
//! chat completions: it picks the view that shows most of the object ([`score_view`], [`best_view`]), draws the box
//! ([`annotated`]), requests JSON as strictly as the server can enforce it (a nested schema, a flat one, any
//! object, the prompt alone), and validates the reply ([`read_reply`]): units, ranges, order of intervals. The
//! model may repair its reply at most twice. Every question ends with an [`Outcome`]: validated values, or a
//! fallback reported in the warnings. Replies are kept on disk by image, prompt and model ([`Cache`]).
//!
//! [`ask_names`] asks for names and short descriptions in the same way. [`choose`] asks the same servers for one of
//! several numbered marks in a picture (visual prompting).
//!
//! ```
//! use sms_vlm::read_reply;
//! let reading = read_reply("Sure: {\"material\": \"glass\", \"density\": \"2.5 g/cm3\", \"friction\":
//! 40}").unwrap();
//! assert_eq!(reading.estimate.density.unwrap().best, 2500.0);
//! assert_eq!(reading.estimate.friction, None, "a friction of 40 is not possible");
//! assert!(reading.faults.iter().any(|f| f.field == "friction"));
//! ```

mod answer;
mod ask;
mod cache;
mod choose;
mod client;
mod config;
mod dialect;
mod material;
mod naming;
mod node;
mod pause;
mod prompt;
mod property;
mod quantity;
mod scene_view;
mod transport;
mod view;

pub use answer::{Fault, Reading, read_reply};
pub use ask::{Answers, GivenUp, Outcome, Question};
pub use cache::Cache;
pub use choose::{ChoiceQuestion, ChooseError, ChosenMark, choose};
pub use client::{Client, Usage};
pub use config::VlmConfig;
pub use dialect::Enforcement;
pub use material::ask;
pub use naming::{ObjectName, ask_names, warn_not_named};
pub use pause::{Pause, Sleep};
pub use scene_view::{question_about, question_about_label};
pub use transport::{ApiKey, HttpTransport, Reply, Request, Transport, TransportError};
pub use view::{ObjectViewScore, PixelBounds, annotated, best_view, jpeg, picture, score_view};

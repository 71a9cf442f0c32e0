//! The simulation-ready scene: manifest, validation, export.

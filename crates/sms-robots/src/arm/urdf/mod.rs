//! Robots from URDF files.
//!
//! Supports links with mass and collision shapes (sphere, cylinder, capsule, box, convex hull of an STL or OBJ), joints
//! of type revolute, continuous, prismatic and fixed with limits, damping and friction, and as an extension the
//! attribute `armature` of `<dynamics>`. Visual shapes, transmissions and simulator elements are skipped.

mod build;
mod collision;
mod stl;
mod xml;

use crate::RobotModel;
use roxmltree::Document;
use serde::{Deserialize, Serialize};
use sms_core::InputError;
use std::collections::BTreeMap;
use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};
use std::path::{Path, PathBuf};

/// Treatment of joints that are not between base and tool.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum OffChain {
    /// They are held at [`UrdfOptions::held`], otherwise at zero (or the limit nearest to it).
    #[default]
    Hold,
    /// They move like the others.
    Move,
}

/// Information that a URDF file lacks.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct UrdfOptions {
    /// Link whose frame is the tool: x along the stroke of a strike, z away from the floor. By default the last link of
    /// a robot that is a single chain.
    pub tool: Option<String>,
    /// Folders that are searched for `package://NAME/…`, as `FOLDER/NAME/…` or, if FOLDER is called NAME, as
    /// `FOLDER/…`, after the URDF's own folder and those above it.
    pub package_folders: Vec<PathBuf>,
    /// Positions of held joints: radians, metres.
    pub held: BTreeMap<String, f64>,
    /// Treatment of joints that are not between base and tool.
    pub off_chain: OffChain,
}

impl RobotModel {
    /// Reads a robot.
    ///
    /// # Errors
    /// [`InputError`] naming the file, the link or joint, and the cure.
    pub fn from_urdf(path: &Path, options: &UrdfOptions) -> Result<Self, InputError> {
        let text = std::fs::read_to_string(path).map_err(|e| {
            InputError::new("this URDF file cannot be read", path, "check the path and its permissions")
                .because(e)
        })?;
        Self::from_urdf_text(&text, path, options)
    }

    /// Reads a robot from the text of a URDF. `path` is named in messages, and meshes are resolved relative to it.
    ///
    /// # Errors
    /// As [`Self::from_urdf`].
    pub fn from_urdf_text(text: &str, path: &Path, options: &UrdfOptions) -> Result<Self, InputError> {
        let source = xml::UrdfSource { path };
        let document = Document::parse(text).map_err(|e| {
            source.error("this is not well-formed XML", "correct the place named above").because(e)
        })?;
        let root = document.root_element();
        if !root.has_tag_name("robot") {
            return Err(source.error(
                format!("the outermost element is <{}>, not <robot>", root.tag_name().name()),
                "give a URDF file; SDF, MJCF and others have to be converted first",
            ));
        }
        if root.descendants().any(|n| n.tag_name().namespace().is_some_and(|uri| uri.contains("xacro"))) {
            return Err(source.error(
                "this URDF still holds xacro macros",
                "expand it first: `xacro file.urdf.xacro > file.urdf`",
            ));
        }
        build::build(&source, root, options)
    }

    /// The Franka Research 3 with the closed Franka Hand as a fist, seven joints. The tool is `fr3_fist`: the centre of
    /// the two closed rubber tips, x along the sweep, y along the fingers' stroke, z away from the floor when the hand
    /// points down; the front of the fist is the plane x = [`crate::FIST_HALF`]`.x`, 8.75 mm ahead.
    ///
    /// Sources: `assets/make_fr3.py`.
    ///
    /// # Panics
    /// Never: the file is embedded and tested.
    pub fn fr3() -> Self {
        let options = UrdfOptions { tool: Some("fr3_fist".to_owned()), ..Default::default() };
        Self::from_urdf_text(FR3_URDF, Path::new("fr3.urdf (built in)"), &options)
            .expect("the built-in robot is valid")
            .with_home(&FR3_HOME)
    }
}

/// The built-in robot's URDF.
pub const FR3_URDF: &str = include_str!("../../../assets/fr3.urdf");

/// Home of the Franka Research 3, radians: hand down, 0.55 m in front of the base.
pub(super) const FR3_HOME: [f64; 7] = [0.0, 0.0, 0.0, -FRAC_PI_2, 0.0, FRAC_PI_2, -FRAC_PI_4];

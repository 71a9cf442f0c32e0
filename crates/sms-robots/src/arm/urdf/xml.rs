//! The supported elements of URDF as plain data, with errors that name element and line.

use glamx::{DMat3, DPose3, DQuat, DVec3};
use roxmltree::Node;
use sms_core::InputError;
use std::path::Path;

/// The document for error messages.
pub(super) struct UrdfSource<'a> {
    pub(super) path: &'a Path,
}

impl UrdfSource<'_> {
    pub(super) fn error(&self, what: impl Into<String>, cure: impl Into<String>) -> InputError {
        InputError::new(what, self.path, cure)
    }

    /// The named child element, if present.
    pub(super) fn child<'n, 'd>(&self, node: Node<'n, 'd>, tag: &str) -> Option<Node<'n, 'd>> {
        node.children().find(|c| c.has_tag_name(tag))
    }

    pub(super) fn attribute<'n>(&self, node: Node<'n, '_>, key: &str) -> Result<&'n str, InputError> {
        node.attribute(key).ok_or_else(|| {
            self.error(
                format!("<{}> at {} has no `{key}`", node.tag_name().name(), place(node)),
                format!("add {key}=\"…\" there"),
            )
        })
    }

    /// A number; `None` where the attribute is absent.
    pub(super) fn number(&self, node: Node, key: &str) -> Result<Option<f64>, InputError> {
        let Some(text) = node.attribute(key) else { return Ok(None) };
        text.trim().parse::<f64>().ok().filter(|x| x.is_finite()).map(Some).ok_or_else(|| {
            self.error(
                format!("{key}=\"{text}\" of <{}> at {} is not a number", node.tag_name().name(), place(node)),
                "write a finite number; xacro expressions have to be expanded first (`xacro file.xacro > file.urdf`)",
            )
        })
    }

    pub(super) fn required(&self, node: Node, key: &str) -> Result<f64, InputError> {
        self.attribute(node, key)?;
        Ok(self.number(node, key)?.unwrap_or(0.0))
    }

    pub(super) fn vector(&self, node: Node, key: &str) -> Result<Option<DVec3>, InputError> {
        let Some(text) = node.attribute(key) else { return Ok(None) };
        let parts: Vec<f64> =
            text.split_whitespace().filter_map(|w| w.parse().ok()).filter(|x: &f64| x.is_finite()).collect();
        if parts.len() == 3 && text.split_whitespace().count() == 3 {
            return Ok(Some(DVec3::from_slice(&parts)));
        }
        Err(self.error(
            format!(
                "{key}=\"{text}\" of <{}> at {} is not three numbers",
                node.tag_name().name(),
                place(node)
            ),
            "write three finite numbers with spaces between them",
        ))
    }

    /// The pose of the `<origin>` child; the identity if absent.
    pub(super) fn origin(&self, node: Node) -> Result<DPose3, InputError> {
        let Some(origin) = self.child(node, "origin") else { return Ok(DPose3::IDENTITY) };
        let xyz = self.vector(origin, "xyz")?.unwrap_or(DVec3::ZERO);
        let rpy = self.vector(origin, "rpy")?.unwrap_or(DVec3::ZERO);
        // URDF: fixed axes, roll about x first, then pitch about y, then yaw about z.
        let rotation =
            DQuat::from_rotation_z(rpy.z) * DQuat::from_rotation_y(rpy.y) * DQuat::from_rotation_x(rpy.x);
        Ok(DPose3::from_parts(xyz, rotation.normalize()))
    }

    /// Mass, centre of mass and inertia of a link, unchecked; `None` if absent.
    pub(super) fn inertial(&self, link: Node) -> Result<Option<Inertial>, InputError> {
        let Some(node) = self.child(link, "inertial") else { return Ok(None) };
        let missing = |tag: &str| {
            self.error(
                format!("<inertial> at {} has no <{tag}>", place(node)),
                "state mass and inertia, or leave out <inertial>",
            )
        };
        let mass = self.required(self.child(node, "mass").ok_or_else(|| missing("mass"))?, "value")?;
        let i = self.child(node, "inertia").ok_or_else(|| missing("inertia"))?;
        let get = |key: &str| self.required(i, key);
        let off = |key: &str| Ok::<f64, InputError>(self.number(i, key)?.unwrap_or(0.0));
        let (xy, xz, yz) = (off("ixy")?, off("ixz")?, off("iyz")?);
        let inertia = DMat3::from_cols(
            DVec3::new(get("ixx")?, xy, xz),
            DVec3::new(xy, get("iyy")?, yz),
            DVec3::new(xz, yz, get("izz")?),
        );
        Ok(Some(Inertial { mass, x_li: self.origin(node)?, inertia }))
    }
}

/// The `<inertial>` of a link: inertia about the centre, in the axes of `x_li`.
pub(super) struct Inertial {
    pub(super) mass: f64,
    pub(super) x_li: DPose3,
    pub(super) inertia: DMat3,
}

impl Inertial {
    pub(super) fn is_nothing(&self) -> bool {
        self.mass == 0.0 && self.inertia == DMat3::ZERO
    }
}

/// The line of an element.
pub(super) fn place(node: Node) -> String {
    let at = node.document().text_pos_at(node.range().start);
    format!("line {}", at.row)
}

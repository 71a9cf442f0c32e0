//! Builds the tree of bodies from the elements of a URDF.

use super::collision::shapes;
use super::xml::{Inertial, UrdfSource, place};
use super::{OffChain, UrdfOptions};
use crate::arm::model::{GRAVITY_W, JointLimits, LinkCollision, merged, transformed};
use crate::{FrameId, Joint, JointKind, LinkFrame, MAX_JOINTS, RobotModel};
use glamx::{DPose3, DQuat, DVec3};
use roxmltree::Node;
use sms_core::{InputError, MassProperties};
use std::collections::BTreeMap;

struct RawJoint<'n, 'd> {
    node: Node<'n, 'd>,
    name: &'n str,
    /// `None` for a fixed joint.
    kind: Option<JointKind>,
    parent: usize,
    child: usize,
}

pub(super) fn build(
    source: &UrdfSource,
    root: Node,
    options: &UrdfOptions,
) -> Result<RobotModel, InputError> {
    let (links, joints) = read_tree(source, root)?;
    let base = base_link(source, &links, &joints)?;
    let tool = tool_link(source, &links, &joints, options)?;
    let held = held_joints(source, &joints, base, tool, options)?;
    let mut builder = TreeBuilder {
        source,
        options,
        links: &links,
        raw: &joints,
        held,
        model: RobotModel {
            name: root.attribute("name").unwrap_or("robot").to_owned(),
            joints: Vec::new(),
            frames: Vec::new(),
            collisions: Vec::new(),
            tool: FrameId(0),
            x_wr: DPose3::IDENTITY,
            gravity_w: GRAVITY_W,
            home: Vec::new(),
            pairs: Vec::new(),
        },
    };
    builder.add_link(base, None, DPose3::IDENTITY)?;
    let mut model = builder.model;
    if model.dof() > MAX_JOINTS {
        return Err(source.error(
            format!("{} joints move; at most {MAX_JOINTS} may", model.dof()),
            "name a tool, so that joints off its chain are held, or hold some in `held`",
        ));
    }
    if model.joints.is_empty() {
        return Err(source.error(
            "no joint between the base and the tool moves",
            "name as tool a link beyond a revolute, continuous or prismatic joint",
        ));
    }
    check_masses(source, &model)?;
    model.tool = model.frame(links[tool].0).unwrap_or(FrameId(0));
    model.home = model
        .joints
        .iter()
        .map(|j| if j.kind == JointKind::Continuous { 0.0 } else { 0.5 * (j.limits.lower + j.limits.upper) })
        .collect();
    model.find_pairs();
    Ok(model)
}

type Links<'n, 'd> = Vec<(&'n str, Node<'n, 'd>)>;

fn read_tree<'n, 'd>(
    source: &UrdfSource,
    root: Node<'n, 'd>,
) -> Result<(Links<'n, 'd>, Vec<RawJoint<'n, 'd>>), InputError> {
    let mut links: Links = Vec::new();
    for node in root.children().filter(|c| c.has_tag_name("link")) {
        let name = source.attribute(node, "name")?;
        if links.iter().any(|(n, _)| *n == name) {
            return Err(source.error(format!("two links are called {name}"), "give every link its own name"));
        }
        links.push((name, node));
    }
    if links.is_empty() {
        return Err(source.error("there is no <link>", "give the URDF of a robot"));
    }
    let mut joints: Vec<RawJoint> = Vec::new();
    for node in root.children().filter(|c| c.has_tag_name("joint")) {
        let name = source.attribute(node, "name")?;
        if joints.iter().any(|j| j.name == name) {
            return Err(
                source.error(format!("two joints are called {name}"), "give every joint its own name")
            );
        }
        let end = |tag: &str| {
            let node = source.child(node, tag).ok_or_else(|| {
                source.error(format!("joint {name} has no <{tag}>"), format!("add <{tag} link=\"…\"/>"))
            })?;
            let link = source.attribute(node, "link")?;
            links.iter().position(|(n, _)| *n == link).ok_or_else(|| {
                source.error(
                    format!("joint {name} names the {tag} link {link}, which does not exist"),
                    format!("correct the name; links are: {}", names(links.iter().map(|l| l.0))),
                )
            })
        };
        let kind = match source.attribute(node, "type")? {
            "revolute" => Some(JointKind::Revolute),
            "continuous" => Some(JointKind::Continuous),
            "prismatic" => Some(JointKind::Prismatic),
            "fixed" => None,
            other => {
                return Err(source.error(
                    format!("joint {name} is of the type `{other}`"),
                    "only revolute, continuous, prismatic and fixed joints are supported; the base is fixed: give \
                     its place as the robot's pose in the world",
                ));
            }
        };
        let (parent, child) = (end("parent")?, end("child")?);
        if let Some(other) = joints.iter().find(|j| j.child == child) {
            return Err(source.error(
                format!("link {} is the child of two joints, {} and {name}", links[child].0, other.name),
                "a URDF is a tree: cut the loop at one of them",
            ));
        }
        joints.push(RawJoint { node, name, kind, parent, child });
    }
    Ok((links, joints))
}

fn names<'a>(all: impl Iterator<Item = &'a str>) -> String {
    all.collect::<Vec<_>>().join(", ")
}

fn base_link(source: &UrdfSource, links: &Links, joints: &[RawJoint]) -> Result<usize, InputError> {
    let roots: Vec<usize> = (0..links.len()).filter(|&l| !joints.iter().any(|j| j.child == l)).collect();
    let &[base] = roots.as_slice() else {
        return Err(if roots.is_empty() {
            source.error("the joints form a loop: every link has a parent", "a URDF is a tree: cut the loop")
        } else {
            source.error(
                format!("{} links have no parent: {}", roots.len(), names(roots.iter().map(|&l| links[l].0))),
                "a robot has one base: join the others to it with fixed joints, or remove them",
            )
        });
    };
    let mut reached = vec![false; links.len()];
    let mut open = vec![base];
    while let Some(l) = open.pop() {
        reached[l] = true;
        open.extend(joints.iter().filter(|j| j.parent == l).map(|j| j.child));
    }
    match reached.iter().position(|r| !r) {
        Some(l) => Err(source.error(
            format!("link {} is part of a loop of joints that is not connected to the base", links[l].0),
            "a URDF is a tree: cut the loop",
        )),
        None => Ok(base),
    }
}

fn tool_link(
    source: &UrdfSource,
    links: &Links,
    joints: &[RawJoint],
    options: &UrdfOptions,
) -> Result<usize, InputError> {
    if let Some(tool) = &options.tool {
        return links.iter().position(|(n, _)| n == tool).ok_or_else(|| {
            source.error(
                format!("the tool {tool} is not a link of this robot"),
                format!("name one of: {}", names(links.iter().map(|l| l.0))),
            )
        });
    }
    let leaves: Vec<usize> = (0..links.len()).filter(|&l| !joints.iter().any(|j| j.parent == l)).collect();
    match leaves.as_slice() {
        [leaf] => Ok(*leaf),
        _ => Err(source.error(
            format!("the robot ends in {} links", leaves.len()),
            format!("name the tool: one of {}", names(leaves.iter().map(|&l| links[l].0))),
        )),
    }
}

/// Positions of the held joints, by index.
fn held_joints(
    source: &UrdfSource,
    joints: &[RawJoint],
    base: usize,
    tool: usize,
    options: &UrdfOptions,
) -> Result<BTreeMap<usize, f64>, InputError> {
    for name in options.held.keys() {
        if !joints.iter().any(|j| j.name == name && j.kind.is_some()) {
            return Err(source.error(
                format!("`held` names {name}, which is not a moving joint of this robot"),
                format!("name one of: {}", names(joints.iter().filter(|j| j.kind.is_some()).map(|j| j.name))),
            ));
        }
    }
    let mut on_chain = vec![false; joints.len()];
    let mut link = tool;
    while link != base {
        let Some(j) = joints.iter().position(|j| j.child == link) else { break };
        on_chain[j] = true;
        link = joints[j].parent;
    }
    let mut held = BTreeMap::new();
    for (i, joint) in joints.iter().enumerate().filter(|(_, j)| j.kind.is_some()) {
        let moves = on_chain[i] || options.off_chain == OffChain::Move;
        if let Some(&q) = options.held.get(joint.name) {
            held.insert(i, q);
        } else if !moves && source.child(joint.node, "mimic").is_none() {
            let limit = source.child(joint.node, "limit");
            let bound = |key: &str| {
                Ok::<_, InputError>(match limit {
                    Some(node) if joint.kind != Some(JointKind::Continuous) => source.number(node, key)?,
                    _ => None,
                })
            };
            let (lower, upper) = (bound("lower")?, bound("upper")?);
            held.insert(i, 0.0f64.min(upper.unwrap_or(0.0)).max(lower.unwrap_or(0.0)));
        }
    }
    for (i, joint) in joints.iter().enumerate().filter(|(_, j)| j.kind.is_some()) {
        let Some(mimic) = source.child(joint.node, "mimic") else { continue };
        if held.contains_key(&i) {
            continue;
        }
        let leader = source.attribute(mimic, "joint")?;
        let Some(leader) = joints.iter().position(|j| j.name == leader) else {
            return Err(source.error(
                format!("joint {} follows {leader}, which does not exist", joint.name),
                "correct the <mimic>",
            ));
        };
        let Some(&q) = held.get(&leader) else {
            return Err(source.error(
                format!("joint {} follows {}, which moves", joint.name, joints[leader].name),
                format!(
                    "joints that follow others are supported only where both are held: hold {} in `held`",
                    joints[leader].name
                ),
            ));
        };
        let factor = source.number(mimic, "multiplier")?.unwrap_or(1.0);
        held.insert(i, factor * q + source.number(mimic, "offset")?.unwrap_or(0.0));
    }
    Ok(held)
}

struct TreeBuilder<'a, 'n, 'd> {
    source: &'a UrdfSource<'a>,
    options: &'a UrdfOptions,
    links: &'a Links<'n, 'd>,
    raw: &'a [RawJoint<'n, 'd>],
    held: BTreeMap<usize, f64>,
    model: RobotModel,
}

impl TreeBuilder<'_, '_, '_> {
    /// Adds a link carried by `carrier` at `x_jl`, and all links beyond it.
    fn add_link(&mut self, link: usize, carrier: Option<usize>, x_jl: DPose3) -> Result<(), InputError> {
        let (name, node) = self.links[link];
        self.model.frames.push(LinkFrame { name: name.to_owned(), joint: carrier, x_jf: x_jl });
        if let Some(joint) = carrier
            && let Some(inertial) = self.source.inertial(node)?
            && !(inertial.is_nothing() && self.is_marker(link))
        {
            let mass = self.link_mass(name, node, &inertial)?;
            let impossible = |e| {
                self.source
                    .error(format!("the mass properties of link {name} cannot be combined"), "check masses")
                    .because(e)
            };
            let carried = transformed(&mass, &x_jl).map_err(impossible)?;
            let total = merged(self.model.joints[joint].mass, carried).map_err(impossible)?;
            self.model.joints[joint].mass = Some(total);
        }
        for (x_ls, shape) in shapes(self.source, node, self.options)? {
            self.model.collisions.push(LinkCollision {
                link: name.to_owned(),
                joint: carrier,
                x_js: x_jl * x_ls,
                radius: shape.bounding_radius(),
                shape,
            });
        }
        for (i, raw) in self.raw.iter().enumerate().filter(|(_, j)| j.parent == link) {
            let x_lj = self.source.origin(raw.node)?;
            match (raw.kind, self.held.get(&i).copied()) {
                (None, _) => self.add_link(raw.child, carrier, x_jl * x_lj)?,
                (Some(kind), Some(q)) => {
                    let axis = self.axis(raw)?;
                    let moved = if kind.turns() {
                        DPose3::from_parts(DVec3::ZERO, DQuat::from_axis_angle(axis, q))
                    } else {
                        DPose3::from_translation(q * axis)
                    };
                    self.add_link(raw.child, carrier, x_jl * x_lj * moved)?;
                }
                (Some(kind), None) => {
                    let joint = self.joint(raw, kind, carrier, x_jl * x_lj)?;
                    self.model.joints.push(joint);
                    let index = self.model.joints.len() - 1;
                    self.add_link(raw.child, Some(index), DPose3::IDENTITY)?;
                }
            }
        }
        Ok(())
    }

    /// Whether a link is attached to a fixed joint. Such links often have a mass of zero to mark a place.
    fn is_marker(&self, link: usize) -> bool {
        self.raw.iter().any(|j| j.child == link && j.kind.is_none())
    }

    fn link_mass(&self, name: &str, node: Node, raw: &Inertial) -> Result<MassProperties, InputError> {
        if raw.mass <= 0.0 {
            return Err(self.source.error(
                format!("link {name} at {} moves and has the mass {} kg", place(node), raw.mass),
                "give it its mass, or remove its <inertial> if it only marks a frame",
            ));
        }
        MassProperties::new(raw.mass, DVec3::ZERO, raw.inertia)
            .and_then(|m| transformed(&m, &raw.x_li))
            .map_err(|e| {
                self.source
                    .error(
                        format!("link {name} at {} has an impossible inertia", place(node)),
                        "correct <inertia>: kg·m² about the centre of mass; each principal moment is positive and at \
                         most the sum of the other two",
                    )
                    .because(e)
            })
    }

    fn axis(&self, raw: &RawJoint) -> Result<DVec3, InputError> {
        let axis = match self.source.child(raw.node, "axis") {
            Some(node) => self.source.vector(node, "xyz")?.unwrap_or(DVec3::X),
            None => DVec3::X,
        };
        if axis.length() < 1e-6 {
            return Err(self.source.error(
                format!("the axis of joint {} is zero", raw.name),
                "state a direction, such as 0 0 1",
            ));
        }
        // Keeps the written value of an axis that is a unit vector up to rounding.
        let off = (axis.length_squared() - 1.0).abs();
        Ok(if off < 1e-15 { axis } else { axis.normalize() })
    }

    fn joint(
        &self,
        raw: &RawJoint,
        kind: JointKind,
        parent: Option<usize>,
        x_pj: DPose3,
    ) -> Result<Joint, InputError> {
        let dynamics = |key: &str| -> Result<f64, InputError> {
            let Some(node) = self.source.child(raw.node, "dynamics") else { return Ok(0.0) };
            let value = self.source.number(node, key)?.unwrap_or(0.0);
            if value < 0.0 {
                return Err(self
                    .source
                    .error(format!("the {key} of joint {} is {value}", raw.name), "state zero or more"));
            }
            Ok(value)
        };
        Ok(Joint {
            name: raw.name.to_owned(),
            kind,
            parent,
            x_pj,
            axis: self.axis(raw)?,
            limits: self.limits(raw, kind)?,
            damping: dynamics("damping")?,
            friction: dynamics("friction")?,
            armature: dynamics("armature")?,
            mass: None,
        })
    }

    fn limits(&self, raw: &RawJoint, kind: JointKind) -> Result<JointLimits, InputError> {
        let missing = |what: &str| {
            self.source.error(
                format!("joint {} states no {what}", raw.name),
                "add <limit lower=\"…\" upper=\"…\" velocity=\"…\" effort=\"…\"/>: a plan is checked against them",
            )
        };
        let node = self.source.child(raw.node, "limit").ok_or_else(|| missing("limits"))?;
        let get = |key: &str| self.source.number(node, key)?.ok_or_else(|| missing(&format!("{key} limit")));
        let (lower, upper) = match kind {
            JointKind::Continuous => (f64::NEG_INFINITY, f64::INFINITY),
            _ => (get("lower")?, get("upper")?),
        };
        let limits = JointLimits { lower, upper, velocity: get("velocity")?, effort: get("effort")? };
        if lower > upper {
            return Err(self.source.error(
                format!("joint {} has its lower limit {lower} above its upper limit {upper}", raw.name),
                "exchange them",
            ));
        }
        if lower == upper {
            return Err(self.source.error(
                format!("joint {} has {lower} as its lower and its upper limit: it can never move", raw.name),
                "state its range, make the joint fixed, or hold it in `held`",
            ));
        }
        for (what, value) in [("velocity", limits.velocity), ("effort", limits.effort)] {
            if value <= 0.0 {
                return Err(self.source.error(
                    format!("the {what} limit of joint {} is {value}: it can never move", raw.name),
                    "state the largest value, or make the joint fixed",
                ));
            }
        }
        Ok(limits)
    }
}

/// Checks that every joint moves some inertia.
fn check_masses(source: &UrdfSource, model: &RobotModel) -> Result<(), InputError> {
    for (i, joint) in model.joints.iter().enumerate() {
        let loaded =
            (0..model.dof()).any(|k| model.chain(Some(k)).any(|c| c == i) && model.joints[k].mass.is_some());
        if !loaded && joint.armature <= 0.0 {
            return Err(source.error(
                format!("nothing beyond joint {} has a mass", joint.name),
                "give its link an <inertial>, or make the joint fixed",
            ));
        }
    }
    Ok(())
}

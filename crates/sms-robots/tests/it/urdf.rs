//! URDF files, valid and faulty: every error names the file and a cure.

use glamx::{DPose3, DVec3};
use sms_core::Mesh;
use sms_robots::{JointKind, LinkShape, OffChain, RobotModel, UrdfOptions, Workspace};
use std::path::Path;

const LIMIT: &str = r#"<limit lower="-1" upper="1" velocity="2" effort="30"/>"#;
const MASS: &str = r#"<inertial><mass value="1"/><inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial>"#;

/// Two links and a joint between them, with `link` inside the second link and `joint` inside the joint.
fn arm(link: &str, kind: &str, joint: &str) -> String {
    format!(
        r#"<robot name="arm"><link name="base"/><link name="hand">{link}</link>
        <joint name="elbow" type="{kind}"><parent link="base"/><child link="hand"/><axis xyz="0 0 1"/>{joint}</joint></robot>"#
    )
}

fn read(text: &str) -> Result<RobotModel, sms_core::InputError> {
    RobotModel::from_urdf_text(text, Path::new("arm.urdf"), &UrdfOptions::default())
}

/// The error of a faulty URDF; it names the file, a cure, and all of `words`.
fn refused(text: &str, words: &[&str]) {
    let message = match read(text) {
        Ok(_) => panic!("not refused: {text}"),
        Err(e) => e.to_string(),
    };
    assert!(message.contains("arm.urdf") && message.contains("cure: "), "{message}");
    for word in words {
        assert!(message.contains(word), "no `{word}` in: {message}");
    }
}

#[test]
fn the_arm_of_these_tests_is_good() {
    let model = read(&arm(MASS, "revolute", LIMIT)).unwrap();
    assert_eq!(model.dof(), 1);
    assert_eq!(model.joints()[0].limits.velocity, 2.0);
    assert_eq!(model.home(), [0.0]);
    let text = arm(MASS, "continuous", r#"<limit velocity="2" effort="30"/>"#);
    assert_eq!(read(&text).unwrap().joints()[0].kind, JointKind::Continuous);
}

#[test]
fn files_that_are_no_urdf_are_refused() {
    refused("<robot><link", &["XML"]);
    refused("", &["XML"]);
    refused("<mujoco/>", &["<mujoco>"]);
    refused("<robot name='r'/>", &["no <link>"]);
    refused(
        "<robot xmlns:xacro='http://www.ros.org/wiki/xacro'><xacro:include filename='a'/><link name='a'/></robot>",
        &["xacro"],
    );
    let missing = RobotModel::from_urdf(Path::new("/no/such/arm.urdf"), &UrdfOptions::default()).unwrap_err();
    assert!(missing.to_string().contains("/no/such/arm.urdf"), "{missing}");
}

#[test]
fn masses_that_no_body_has_are_refused() {
    for mass in ["0", "-1"] {
        let text = arm(&MASS.replace("value=\"1\"", &format!("value=\"{mass}\"")), "revolute", LIMIT);
        refused(&text, &["hand", "kg"]);
    }
    refused(
        &arm(&MASS.replace("ixx=\"0.1\"", "ixx=\"0.3\""), "revolute", LIMIT),
        &["hand", "principal moments"],
    );
    refused(&arm(&MASS.replace("ixx=\"0.1\"", "ixx=\"-0.1\""), "revolute", LIMIT), &["hand"]);
    refused(&arm(&MASS.replace("value=\"1\"", "value=\"one\""), "revolute", LIMIT), &["one", "number"]);
    refused(&arm(&MASS.replace("value=\"1\"", "value=\"nan\""), "revolute", LIMIT), &["nan"]);
    refused(&arm("<inertial><mass value=\"1\"/></inertial>", "revolute", LIMIT), &["no <inertia>"]);
    refused(&arm("", "revolute", LIMIT), &["elbow", "mass"]);
}

#[test]
fn a_mark_of_no_mass_on_a_fixed_joint_is_no_fault() {
    let nothing = MASS.replace("value=\"1\"", "value=\"0\"").replace("0.1", "0");
    let mark = format!(
        "<link name=\"mark\">{nothing}</link><joint name=\"m\" type=\"fixed\"><parent link=\"hand\"/>\
         <child link=\"mark\"/></joint></robot>"
    );
    let with_mark = |link: &str| arm(link, "revolute", LIMIT).replace("</robot>", &mark);
    assert_eq!(read(&with_mark(MASS)).unwrap().joints()[0].mass.unwrap().mass(), 1.0);
    refused(&with_mark(&nothing), &["hand", "0 kg"]);
}

#[test]
fn joints_that_cannot_be_driven_are_refused() {
    for kind in ["floating", "planar", "screw"] {
        refused(&arm(MASS, kind, LIMIT), &["elbow", kind]);
    }
    refused(&arm(MASS, "revolute", ""), &["elbow", "limits"]);
    refused(&arm(MASS, "revolute", r#"<limit lower="-1" upper="1" velocity="2"/>"#), &["elbow", "effort"]);
    refused(&arm(MASS, "prismatic", r#"<limit velocity="2" effort="1"/>"#), &["elbow", "lower"]);
    refused(
        &arm(MASS, "revolute", &LIMIT.replace("lower=\"-1\"", "lower=\"3\"")),
        &["elbow", "lower limit 3"],
    );
    refused(&arm(MASS, "revolute", &LIMIT.replace("lower=\"-1\"", "lower=\"1\"")), &["elbow", "never move"]);
    refused(
        &arm(MASS, "revolute", &LIMIT.replace("velocity=\"2\"", "velocity=\"0\"")),
        &["velocity", "never move"],
    );
    refused(&arm(MASS, "fixed", ""), &["no joint"]);
    let zero_axis = arm(MASS, "revolute", LIMIT).replace("0 0 1", "0 0 0");
    refused(&zero_axis, &["axis", "elbow"]);
    refused(&arm(MASS, "revolute", LIMIT).replace("0 0 1", "0 0"), &["three numbers"]);
    refused(&arm(MASS, "revolute", &format!("{LIMIT}<dynamics damping=\"-1\"/>")), &["damping", "elbow"]);
}

#[test]
fn what_is_no_tree_is_refused() {
    let links = |names: &str| {
        names.split(' ').map(|n| format!("<link name=\"{n}\">{MASS}</link>")).collect::<String>()
    };
    let joint = |name: &str, parent: &str, child: &str| {
        format!(
            "<joint name=\"{name}\" type=\"revolute\"><parent link=\"{parent}\"/><child link=\"{child}\"/>{LIMIT}</joint>"
        )
    };
    let robot = |inside: String| format!("<robot name=\"r\">{inside}</robot>");
    refused(&robot(links("a b") + &joint("j", "a", "c")), &["c", "does not exist", "a, b"]);
    refused(&robot(links("a b c") + &joint("j", "a", "b")), &["no parent", "a, c"]);
    refused(&robot(links("a b") + &joint("j", "a", "b") + &joint("k", "b", "a")), &["loop"]);
    let island = links("a b c") + &joint("j", "b", "c") + &joint("k", "c", "b");
    refused(&robot(island), &["loop"]);
    let two = links("a b c") + &joint("j", "a", "c") + &joint("k", "b", "c") + &joint("l", "a", "b");
    refused(&robot(two), &["two joints", "c"]);
    refused(&robot(links("a a")), &["two links"]);
    refused(&robot(links("a b c") + &joint("j", "a", "b") + &joint("j", "b", "c")), &["two joints"]);
    refused(
        &robot(links("a b c") + &joint("j", "a", "b") + &joint("k", "a", "c")),
        &["name the tool", "b, c"],
    );
    let chain: String = (0..18).map(|i| format!("<link name=\"l{i}\">{MASS}</link>")).collect();
    let joints: String =
        (0..17).map(|i| joint(&format!("j{i}"), &format!("l{i}"), &format!("l{}", i + 1))).collect();
    refused(&robot(chain + &joints), &["17 joints", "16"]);
}

#[test]
fn unknown_tools_and_held_joints_are_refused() {
    let text = arm(MASS, "revolute", LIMIT);
    let read = |options: UrdfOptions| RobotModel::from_urdf_text(&text, Path::new("arm.urdf"), &options);
    let message =
        read(UrdfOptions { tool: Some("claw".into()), ..Default::default() }).unwrap_err().to_string();
    assert!(message.contains("claw") && message.contains("base, hand"), "{message}");
    let held = [("wrist".to_owned(), 0.0)].into();
    let message = read(UrdfOptions { held, ..Default::default() }).unwrap_err().to_string();
    assert!(message.contains("wrist") && message.contains("elbow"), "{message}");
}

#[test]
fn joints_that_follow_are_held_with_their_leader_or_refused() {
    let follower = format!(
        "<link name=\"finger\">{MASS}</link><link name=\"thumb\">{MASS}</link>\
         <joint name=\"grip\" type=\"prismatic\"><parent link=\"hand\"/><child link=\"finger\"/><axis xyz=\"1 0 0\"/>{LIMIT}</joint>\
         <joint name=\"grip2\" type=\"prismatic\"><parent link=\"hand\"/><child link=\"thumb\"/><axis xyz=\"1 0 0\"/>{LIMIT}\
         <mimic joint=\"grip\" multiplier=\"-2\" offset=\"0.1\"/></joint></robot>"
    );
    let text = arm(MASS, "revolute", LIMIT).replace("</robot>", &follower);
    let read = |options: UrdfOptions| RobotModel::from_urdf_text(&text, Path::new("arm.urdf"), &options);
    let tool = Some("hand".to_owned());
    let held = [("grip".to_owned(), 0.3)].into();
    let model = read(UrdfOptions { tool: tool.clone(), held, ..Default::default() }).unwrap();
    assert_eq!(model.dof(), 1);
    let mut ws = Workspace::default();
    model.forward_kinematics(&[0.0], &mut ws);
    let x = |link: &str| model.frame_pose(model.frame(link).unwrap(), &ws).translation.x;
    assert!((x("finger") - 0.3).abs() < 1e-15 && (x("thumb") + 0.5).abs() < 1e-15);
    let message =
        read(UrdfOptions { tool, off_chain: OffChain::Move, ..Default::default() }).unwrap_err().to_string();
    assert!(message.contains("grip2") && message.contains("hold grip"), "{message}");
}

#[test]
fn collision_shapes_and_meshes_are_checked() {
    let with = |geometry: &str| {
        arm(&format!("{MASS}<collision><geometry>{geometry}</geometry></collision>"), "revolute", LIMIT)
    };
    refused(&with(""), &["no geometry"]);
    refused(&with("<sphere radius=\"0\"/>"), &["radius", "positive"]);
    refused(&with("<box size=\"1 2 -3\"/>"), &["size"]);
    refused(&with("<cylinder radius=\"1\"/>"), &["length"]);
    refused(&with("<cone radius=\"1\"/>"), &["cone"]);
    refused(&with("<mesh filename=\"no/such.stl\"/>"), &["no/such.stl", "put the mesh"]);
    refused(&with("<mesh filename=\"package://robots/no/such.stl\"/>"), &["such.stl", "package_folders"]);
    assert_eq!(read(&with("<capsule radius=\"0.1\" length=\"0.4\"/>")).unwrap().collisions().len(), 1);

    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("robots/meshes");
    Mesh::cuboid(DVec3::new(0.1, 0.2, 0.3)).write_obj(&folder.join("block.obj")).unwrap();
    std::fs::write(folder.join("block.dae"), "<COLLADA/>").unwrap();
    std::fs::write(folder.join("broken.stl"), "solid x\n vertex 1 2").unwrap();
    let flat =
        Mesh::new(vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::X + DVec3::Y], vec![[0, 1, 2], [1, 3, 2]]);
    flat.write_obj(&folder.join("flat.obj")).unwrap();
    let read_in = |place: &str, file: &str, scale: &str, options: &UrdfOptions| {
        let path = dir.path().join(place).join("arm.urdf");
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, with(&format!("<mesh filename=\"{file}\" {scale}/>"))).unwrap();
        RobotModel::from_urdf(&path, options)
    };
    let plain = UrdfOptions::default();
    for (place, file) in [
        ("robots", "meshes/block.obj"),
        ("robots", "package://robots/meshes/block.obj"),
        ("robots/urdf/deep", "package://robots/meshes/block.obj"),
    ] {
        let model = read_in(place, file, "scale=\"2 1 -1\"", &plain).unwrap();
        let shape = &model.collisions()[0].shape;
        assert!(
            (shape.support(DVec3::X) - 0.2).abs() < 1e-12 && (shape.support(DVec3::Z) - 0.3).abs() < 1e-12
        );
        assert!(matches!(shape, LinkShape::Convex(_)));
    }
    for folders in [vec![dir.path().to_owned()], vec![dir.path().join("robots")]] {
        let options = UrdfOptions { package_folders: folders, ..Default::default() };
        let elsewhere = tempfile::tempdir().unwrap();
        let path = elsewhere.path().join("arm.urdf");
        std::fs::write(&path, with("<mesh filename=\"package://robots/meshes/block.obj\"/>")).unwrap();
        assert!(RobotModel::from_urdf(&path, &options).is_ok());
    }
    for (file, scale, word) in [
        ("meshes/block.dae", "", "convert it to STL or OBJ"),
        ("meshes/broken.stl", "", "damaged"),
        ("meshes/flat.obj", "", "no volume"),
        ("meshes/block.obj", "scale=\"1 0 1\"", "zero scale"),
    ] {
        let message = read_in("robots", file, scale, &plain).unwrap_err().to_string();
        assert!(message.contains(word), "{message}");
    }
}

#[test]
fn the_built_in_robot_stands_as_its_maker_says() {
    let model = RobotModel::fr3();
    let mut ws = Workspace::default();
    // In the home posture of the source, the flange is at (0.5545, 0, 0.6245) m.
    model.forward_kinematics(model.home(), &mut ws);
    let flange = model.frame_pose(model.frame("fr3_link8").unwrap(), &ws);
    assert!((flange.translation - DVec3::new(0.5545, 0.0, 0.6245)).length() < 1e-4, "{}", flange.translation);
    let fist: DPose3 = model.frame_pose(model.tool(), &ws);
    assert!((fist.rotation * DVec3::Z - DVec3::Z).length() < 1e-12, "z points up");
    assert!((fist.rotation * DVec3::X).z.abs() < 1e-12, "x is level");
    // The fist extends half a fingertip beyond its centre.
    let lowest = model
        .collisions()
        .iter()
        .filter(|c| c.link.contains("finger"))
        .map(|c| {
            let x = model.body_pose(c.joint, &ws) * c.x_js;
            x.translation.z - c.shape.support(x.rotation.inverse() * -DVec3::Z)
        })
        .fold(f64::INFINITY, f64::min);
    assert!((fist.translation.z - lowest - sms_robots::FIST_HALF.z).abs() < 1e-9);
    let total: f64 = model.joints().iter().filter_map(|j| j.mass).map(|m| m.mass()).sum();
    let by_hand = 2.9274653454
        + 2.9355370338
        + 2.2449013699
        + 2.6155955791
        + 2.3271207594
        + 1.8170376524
        + 0.6271432862;
    assert!((total - by_hand - 0.6544 - 2.0 * 0.0291).abs() < 1e-12, "{total}");
}

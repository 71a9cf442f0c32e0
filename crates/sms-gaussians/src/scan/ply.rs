//! The model as a standard 3D Gaussian Splatting `.ply` for viewers. Affinities, labels, their confidence and `measured` (1 on a
//! measured surface, else 0; without it, all are) are additional properties that viewers ignore. Classifier and background are in a separate file.

use crate::harmonics::{BASIS, CONSTANT};
use crate::{AFFINITY_DIM, Classifier, GaussianModel, HIDDEN_DIM, Seedling};
use glamx::{Quat, Vec3};
use serde::{Deserialize, Serialize};
use sms_core::ply::{self, VertexColumn, VertexTable};
use sms_core::{CoreError, InputError, atomic};
use std::path::{Path, PathBuf};

/// Value of the constant spherical harmonic, by which viewers turn `f_dc` into colour: c = 0.5 + SH_C0 · f_dc.
const SH_C0: f32 = 0.282_094_8;
/// Distance of opacities from 0 and 1, where the logit is infinite.
const OPACITY_MARGIN: f32 = 1e-6;
const EXPORT_AGAIN: &str = "run `sms scan` again, or give a 3D Gaussian Splatting PLY";

/// The classifier's file beside a PLY: `scene.ply` has `scene.classifier.json`.
pub(crate) fn classifier_path(ply: &Path) -> PathBuf {
    ply.with_extension("classifier.json")
}

#[derive(Serialize, Deserialize)]
struct ClassifierFile {
    classes: usize,
    w1: Vec<f32>,
    b1: Vec<f32>,
    w2: Vec<f32>,
    b2: Vec<f32>,
    /// Colour behind all Gaussians, stored here because it is not a property of a vertex.
    #[serde(default)]
    background: [f32; 3],
}

/// Writes the model. Rotations are w, x, y, z, scales logarithms of metres, opacities logits, `nx ny nz` the disc's
/// normal; the world is ours (metres, z up).
///
/// # Errors
/// [`CoreError::Write`].
pub fn write_ply(model: &GaussianModel, path: &Path) -> Result<(), CoreError> {
    let c = &model.classifier;
    let file = ClassifierFile {
        classes: c.classes,
        w1: c.w1.clone(),
        b1: c.b1.clone(),
        w2: c.w2.clone(),
        b2: c.b2.clone(),
        background: model.background,
    };
    // The classifier is written first, so that a PLY is never next to an older classifier.
    atomic::write_json(&classifier_path(path), &file)?;
    let column = |value: &dyn Fn(usize) -> f32| VertexColumn::F32((0..model.len()).map(value).collect());
    let normals: Vec<Vec3> = (0..model.len()).map(|i| model.disc(i).0).collect();
    let names = property_names(if model.harmonics.is_empty() { 0 } else { BASIS });
    let columns: Vec<(&str, VertexColumn)> = names
        .iter()
        .map(|name| {
            let (stem, k) = split_index(name);
            let values = match stem {
                "x" => column(&|i| model.positions_w[i].x),
                "y" => column(&|i| model.positions_w[i].y),
                "z" => column(&|i| model.positions_w[i].z),
                "nx" => column(&|i| normals[i].x),
                "ny" => column(&|i| normals[i].y),
                "nz" => column(&|i| normals[i].z),
                "f_dc" => column(&|i| (model.colors[i][k] - 0.5) / SH_C0),
                // Channel by channel, as viewers expect it.
                "f_rest" => column(&|i| model.harmonics[i][3 * (k % BASIS) + k / BASIS]),
                "opacity" => column(&|i| logit(model.opacities[i])),
                "scale" => column(&|i| model.scales[i][k].ln()),
                "rot" => column(&|i| wxyz(model.rotations_wg[i])[k]),
                "affinity" => column(&|i| model.affinities[i][k]),
                "label" => column(&|i| f32::from(model.labels[i])),
                "measured" => column(&|i| f32::from(u8::from(model.is_measured(i)))),
                _ => column(&|i| model.label_confidence[i]),
            };
            (name.as_str(), values)
        })
        .collect();
    ply::write(path, &["frame: world, metres, z up"], &columns)
}

/// All properties in order: the standard ones with `basis` harmonics, then those of this crate.
fn property_names(basis: usize) -> Vec<String> {
    let standard = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"].map(str::to_owned);
    let harmonics = (0..3 * basis).map(|k| format!("f_rest_{k}"));
    let shape = ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"];
    let affinities = (0..AFFINITY_DIM).map(|k| format!("affinity_{k}"));
    let own = ["label", "confidence", "measured"].map(str::to_owned);
    let shape = shape.map(str::to_owned);
    standard.into_iter().chain(harmonics).chain(shape).chain(affinities).chain(own).collect()
}

/// `rot_2` → (`rot`, 2).
fn split_index(name: &str) -> (&str, usize) {
    let numbered = name.rsplit_once('_').and_then(|(stem, k)| Some((stem, k.parse().ok()?)));
    numbered.unwrap_or((name, 0))
}

fn wxyz(q: Quat) -> [f32; 4] {
    [q.w, q.x, q.y, q.z]
}

fn logit(opacity: f32) -> f32 {
    let o = opacity.clamp(OPACITY_MARGIN, 1.0 - OPACITY_MARGIN);
    (o / (1.0 - o)).ln()
}

/// Reads a model. Files of other programs have no affinities, labels, classifier or background; these are then zero
/// and empty.
///
/// # Errors
/// [`CoreError::Input`] if the file is not a Gaussian PLY, contains a number that is not finite, or its classifier
/// is damaged; [`CoreError::Read`] if it cannot be read.
pub fn read_ply(path: &Path) -> Result<GaussianModel, CoreError> {
    let table = ply::read(path)?;
    let mut model = GaussianModel::default();
    let positions = columns(&table, path, ["x", "y", "z"])?;
    let colors = columns(&table, path, ["f_dc_0", "f_dc_1", "f_dc_2"])?;
    let [opacities] = columns(&table, path, ["opacity"])?;
    let scales = columns(&table, path, ["scale_0", "scale_1", "scale_2"])?;
    let rotations = columns(&table, path, ["rot_0", "rot_1", "rot_2", "rot_3"])?;
    let affinity_names: [String; AFFINITY_DIM] = std::array::from_fn(|k| format!("affinity_{k}"));
    let affinities = table
        .column("affinity_0")
        .map(|_| columns(&table, path, affinity_names.each_ref().map(String::as_str)))
        .transpose()?;
    let (labels, confidence) = (table.column("label"), table.column("confidence"));
    if let Some(measured) = table.column("measured").filter(|m| m.contains(&0.0)) {
        model.measured = measured.iter().map(|m| *m != 0.0).collect();
    }
    let harmonics = harmonics_of(&table, path)?;
    for i in 0..table.len {
        model.positions_w.push(Vec3::from_array(positions.map(|c| c[i] as f32)));
        model.colors.push(colors.map(|c| 0.5 + SH_C0 * c[i] as f32));
        if let Some(channels) = &harmonics {
            let value = |j: usize| channels[j % 3].get(j / 3).map_or(0.0, |column| column[i] as f32);
            model.harmonics.push(std::array::from_fn(value));
        }
        model.opacities.push((1.0 / (1.0 + (-opacities[i]).exp())) as f32);
        model.scales.push(Vec3::from_array(scales.map(|c| c[i].exp() as f32)));
        let [w, x, y, z] = rotations.map(|c| c[i] as f32);
        let q = Quat::from_xyzw(x, y, z, w);
        model.rotations_wg.push(if q.length_squared() > 1e-12 { q.normalize() } else { Quat::IDENTITY });
        model.affinities.push(affinities.map_or([0.0; AFFINITY_DIM], |a| a.map(|c| c[i] as f32)));
        model.labels.push(labels.map_or(0, |c| c[i] as u16));
        model.label_confidence.push(confidence.map_or(0.0, |c| c[i] as f32));
    }
    (model.classifier, model.background) = read_classifier(&classifier_path(path))?;
    Ok(model)
}

fn columns<'a, const N: usize>(
    table: &'a VertexTable,
    path: &Path,
    names: [&str; N],
) -> Result<[&'a [f64]; N], CoreError> {
    let mut found: [&[f64]; N] = [&[]; N];
    for (slot, name) in found.iter_mut().zip(names) {
        *slot = table.column(name).ok_or_else(|| {
            InputError::new(format!("this PLY has no property `{name}`"), path, EXPORT_AGAIN)
        })?;
        if let Some(i) = slot.iter().position(|v| !v.is_finite()) {
            return Err(InputError::new(
                format!("`{name}` of Gaussian {i} in this PLY is not a finite number"),
                path,
                EXPORT_AGAIN,
            )
            .into());
        }
    }
    Ok(found)
}

/// Returns the columns of the harmonics by channel, without those of degree 3; `None` if there are none.
fn harmonics_of<'a>(table: &'a VertexTable, path: &Path) -> Result<Option<[Vec<&'a [f64]>; 3]>, CoreError> {
    let name = |k: usize| format!("f_rest_{k}");
    let count = (0..).take_while(|k| table.column(&name(*k)).is_some()).count();
    let of_channel = match count {
        0 => return Ok(None),
        9 | 24 | 45 | 72 => count / 3,
        _ => {
            let what =
                format!("this PLY has {count} properties `f_rest_*`, which no degree of harmonics has");
            return Err(InputError::new(what, path, EXPORT_AGAIN).into());
        }
    };
    let mut channels = [(); 3].map(|()| Vec::new());
    for (c, columns_of_channel) in channels.iter_mut().enumerate() {
        for k in 0..of_channel.min(BASIS) {
            let [column] = columns(table, path, [name(c * of_channel + k).as_str()])?;
            columns_of_channel.push(column);
        }
    }
    Ok(Some(channels))
}

/// The classifier and the background.
fn read_classifier(path: &Path) -> Result<(Classifier, [f32; 3]), CoreError> {
    if !path.exists() {
        return Ok(Default::default());
    }
    let f: ClassifierFile = atomic::read_json(path)?;
    let fits = f.classes == 0
        || (f.w1.len() == HIDDEN_DIM * AFFINITY_DIM
            && f.b1.len() == HIDDEN_DIM
            && f.w2.len() == f.classes * HIDDEN_DIM
            && f.b2.len() == f.classes);
    if !fits {
        let what = "the sizes in this classifier are inconsistent";
        return Err(InputError::new(what, path, "run `sms scan` again").into());
    }
    Ok((Classifier { classes: f.classes, w1: f.w1, b1: f.b1, w2: f.w2, b2: f.b2 }, f.background))
}

/// The Gaussians of a model as seedlings.
pub(crate) fn seedlings_of(model: &GaussianModel) -> Vec<Seedling> {
    (0..model.len())
        .map(|i| Seedling {
            position_w: model.positions_w[i],
            rotation_wg: model.rotations_wg[i],
            scale: model.scales[i],
            opacity: model.opacities[i],
            color: model.colors[i],
            harmonics: model.harmonics.get(i).copied().unwrap_or(CONSTANT),
            affinity: model.affinities[i],
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::RngExt;
    use sms_core::Seed;

    fn model(n: usize) -> GaussianModel {
        let mut rng = Seed(3).rng();
        let mut draw = |low: f32, high: f32| rng.random_range(low..high);
        let mut model = GaussianModel {
            classifier: Classifier {
                classes: 3,
                w1: (0..HIDDEN_DIM * AFFINITY_DIM).map(|_| draw(-1.0, 1.0)).collect(),
                b1: (0..HIDDEN_DIM).map(|_| draw(-1.0, 1.0)).collect(),
                w2: (0..3 * HIDDEN_DIM).map(|_| draw(-1.0, 1.0)).collect(),
                b2: (0..3).map(|_| draw(-1.0, 1.0)).collect(),
            },
            background: [0.25, 0.5, 0.7],
            ..GaussianModel::default()
        };
        for _ in 0..n {
            model.positions_w.push(Vec3::new(draw(-1.0, 1.0), draw(-1.0, 1.0), draw(-1.0, 1.0)));
            let q = Quat::from_xyzw(draw(-1.0, 1.0), draw(-1.0, 1.0), draw(-1.0, 1.0), draw(0.1, 1.0));
            model.rotations_wg.push(q.normalize());
            model.scales.push(Vec3::new(draw(1e-4, 0.1), draw(1e-4, 0.1), draw(1e-5, 0.1)));
            model.opacities.push(draw(0.01, 0.99));
            model.colors.push([draw(0.0, 1.0), draw(0.0, 1.0), draw(0.0, 1.0)]);
            model.harmonics.push(std::array::from_fn(|_| draw(-0.5, 0.5)));
            let affinity = std::array::from_fn(|_| draw(-2.0, 2.0));
            let (label, confidence) = model.classifier.classify(&affinity);
            model.affinities.push(affinity);
            model.labels.push(label);
            model.label_confidence.push(confidence);
        }
        model
    }

    #[test]
    fn a_model_round_trips() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("scene.ply");
        let written = model(40);
        write_ply(&written, &path).unwrap();
        let read = read_ply(&path).unwrap();
        assert_eq!((&read.classifier, read.background), (&written.classifier, written.background));
        assert_eq!((&read.positions_w, &read.affinities), (&written.positions_w, &written.affinities));
        assert_eq!(read.harmonics, written.harmonics);
        assert_eq!((&read.labels, &read.label_confidence), (&written.labels, &written.label_confidence));
        for i in 0..written.len() {
            assert!(((read.scales[i] - written.scales[i]) / written.scales[i]).abs().max_element() < 1e-5);
            assert!((read.opacities[i] - written.opacities[i]).abs() < 1e-6);
            assert!((0..3).all(|k| (read.colors[i][k] - written.colors[i][k]).abs() < 1e-6));
            assert!(read.rotations_wg[i].dot(written.rotations_wg[i]).abs() > 1.0 - 1e-6);
        }
    }

    #[test]
    fn the_header_is_readable_by_viewers() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("scene.ply");
        write_ply(&model(2), &path).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let marker = b"end_header\n";
        let end = bytes.windows(marker.len()).position(|w| w == marker).unwrap() + marker.len();
        let mut expected = String::from(
            "ply\nformat binary_little_endian 1.0\ncomment frame: world, metres, z up\nelement vertex 2\n",
        );
        let standard = "x y z nx ny nz f_dc_0 f_dc_1 f_dc_2";
        let shape = "opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3";
        let harmonics = (0..24).map(|k| format!("f_rest_{k}"));
        let names = standard.split(' ').map(str::to_owned).chain(harmonics);
        let names = names.chain(shape.split(' ').map(str::to_owned));
        let own = (0..16)
            .map(|k| format!("affinity_{k}"))
            .chain(["label", "confidence", "measured"].map(String::from));
        names.chain(own).for_each(|n| expected.push_str(&format!("property float {n}\n")));
        expected.push_str("end_header\n");
        assert_eq!(std::str::from_utf8(&bytes[..end]).unwrap(), expected);
        assert_eq!(bytes.len() - end, 2 * 60 * 4);
    }

    #[test]
    fn files_of_other_programs_are_read_and_broken_ones_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("other.ply");
        let standard: Vec<String> = property_names(0).into_iter().take(17).collect();
        let mut columns: Vec<(&str, VertexColumn)> =
            standard.iter().map(|n| (n.as_str(), VertexColumn::F32(vec![0.0, 0.5]))).collect();
        ply::write(&path, &[], &columns).unwrap();
        let read = read_ply(&path).unwrap();
        assert_eq!((read.len(), read.classifier.classes, read.labels[1]), (2, 0, 0));
        assert_eq!((read.rotations_wg[0], read.background), (Quat::IDENTITY, [0.0; 3]));

        // Harmonics are stored channel by channel, 3 of degree 1 or 15 up to degree 3.
        for (count, of_channel) in [(9, 3), (45, 15)] {
            let names: Vec<String> = (0..count).map(|k| format!("f_rest_{k}")).collect();
            let mut with = columns.clone();
            for (k, name) in names.iter().enumerate() {
                with.push((name, VertexColumn::F32(vec![k as f32 + 1.0; 2])));
            }
            ply::write(&path, &[], &with).unwrap();
            let harmonics = read_ply(&path).unwrap().harmonics;
            for (k, c) in (0..BASIS).flat_map(|k| (0..3).map(move |c| (k, c))) {
                let expected = if k < of_channel { (c * of_channel + k) as f32 + 1.0 } else { 0.0 };
                assert_eq!(harmonics[1][3 * k + c], expected, "{count}: {k} {c}");
            }
            with.pop();
            ply::write(&path, &[], &with).unwrap();
            assert!(matches!(read_ply(&path), Err(CoreError::Input(_))));
        }

        columns[12].1 = VertexColumn::F32(vec![0.0, f32::NAN]);
        ply::write(&path, &[], &columns).unwrap();
        let fault = |path: &Path| match read_ply(path) {
            Err(CoreError::Input(e)) => (e.path, e.what),
            other => panic!("{other:?}"),
        };
        let (file, what) = fault(&path);
        assert!(file.ends_with("other.ply") && what.contains(&standard[12]), "{what}");
        columns.remove(9);
        ply::write(&path, &[], &columns).unwrap();
        assert!(fault(&path).1.contains(&standard[9]));

        let path = dir.path().join("scene.ply");
        write_ply(&model(1), &path).unwrap();
        std::fs::write(classifier_path(&path), r#"{"classes":2,"w1":[],"b1":[],"w2":[],"b2":[]}"#).unwrap();
        assert!(fault(&path).0.ends_with("scene.classifier.json"));
    }
}

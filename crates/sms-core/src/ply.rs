//! PLY vertex tables: written as binary little-endian, read as ASCII or binary (either byte order).
//!
//! Column names follow the field: `x y z nx ny nz red green blue` for clouds, the 3D Gaussian Splatting names for
//! Gaussians.

use crate::{CoreError, InputError, PointCloud, atomic};
use glamx::DVec3;
use std::path::Path;

/// One column of a vertex table.
#[derive(Debug, Clone, PartialEq)]
pub enum VertexColumn {
    /// 32-bit floats.
    F32(Vec<f32>),
    /// Bytes.
    U8(Vec<u8>),
    /// 32-bit integers.
    I32(Vec<i32>),
}

impl VertexColumn {
    fn len(&self) -> usize {
        match self {
            Self::F32(v) => v.len(),
            Self::U8(v) => v.len(),
            Self::I32(v) => v.len(),
        }
    }
}

/// Writes a vertex table atomically. All columns have the same length.
///
/// # Errors
/// [`CoreError::Write`].
pub fn write(path: &Path, comments: &[&str], columns: &[(&str, VertexColumn)]) -> Result<(), CoreError> {
    let n = columns.first().map_or(0, |c| c.1.len());
    assert!(columns.iter().all(|c| c.1.len() == n), "PLY columns must have the same length");
    atomic::write_with(path, |w| {
        let mut header = String::from("ply\nformat binary_little_endian 1.0\n");
        for comment in comments {
            header.push_str(&format!("comment {comment}\n"));
        }
        header.push_str(&format!("element vertex {n}\n"));
        for (name, column) in columns {
            let kind = match column {
                VertexColumn::F32(_) => "float",
                VertexColumn::U8(_) => "uchar",
                VertexColumn::I32(_) => "int",
            };
            header.push_str(&format!("property {kind} {name}\n"));
        }
        header.push_str("end_header\n");
        w.write_all(header.as_bytes())?;
        for i in 0..n {
            for (_, column) in columns {
                match column {
                    VertexColumn::F32(v) => w.write_all(&v[i].to_le_bytes())?,
                    VertexColumn::U8(v) => w.write_all(&[v[i]])?,
                    VertexColumn::I32(v) => w.write_all(&v[i].to_le_bytes())?,
                }
            }
        }
        Ok(())
    })
}

/// The vertex element of a PLY file, every column as `f64`.
#[derive(Debug, Clone, Default)]
pub struct VertexTable {
    /// Column names and values.
    pub columns: Vec<(String, Vec<f64>)>,
    /// Number of vertices.
    pub len: usize,
}

impl VertexTable {
    /// Returns the values of a column.
    pub fn column(&self, name: &str) -> Option<&[f64]> {
        self.columns.iter().find(|c| c.0 == name).map(|c| c.1.as_slice())
    }
}

#[derive(Clone, Copy)]
struct Scalar {
    bytes: usize,
    float: bool,
    signed: bool,
}

fn scalar(name: &str) -> Option<Scalar> {
    let (bytes, float, signed) = match name {
        "char" | "int8" => (1, false, true),
        "uchar" | "uint8" => (1, false, false),
        "short" | "int16" => (2, false, true),
        "ushort" | "uint16" => (2, false, false),
        "int" | "int32" => (4, false, true),
        "uint" | "uint32" => (4, false, false),
        "float" | "float32" => (4, true, true),
        "double" | "float64" => (8, true, true),
        _ => return None,
    };
    Some(Scalar { bytes, float, signed })
}

fn decode(kind: Scalar, raw: &[u8], big_endian: bool) -> f64 {
    let mut le = [0u8; 8];
    for (i, &b) in raw.iter().enumerate() {
        le[if big_endian { kind.bytes - 1 - i } else { i }] = b;
    }
    let bits = u64::from_le_bytes(le);
    match (kind.float, kind.bytes) {
        (true, 4) => f64::from(f32::from_bits(bits as u32)),
        (true, _) => f64::from_bits(bits),
        (false, n) if kind.signed => {
            let shift = 64 - 8 * n as u32;
            (((bits << shift) as i64) >> shift) as f64
        }
        _ => bits as f64,
    }
}

/// Reads the vertex element, which must come first (as it does in every common writer).
///
/// # Errors
/// [`CoreError::Read`] when the file cannot be read, [`CoreError::Input`] when it has another layout or is truncated.
pub fn read(path: &Path) -> Result<VertexTable, CoreError> {
    let bytes = std::fs::read(path).map_err(CoreError::read(path))?;
    let bad = |reason: &str| {
        CoreError::Input(InputError::new(
            format!("this PLY cannot be read: {reason}"),
            path,
            "export it again as ASCII or binary PLY with the vertices first",
        ))
    };
    let marker = b"end_header";
    let end = bytes.windows(marker.len()).position(|w| w == marker).ok_or_else(|| bad("no end of header"))?;
    let body_start =
        bytes[end..].iter().position(|&b| b == b'\n').map(|p| end + p + 1).ok_or_else(|| bad("no body"))?;
    let header = String::from_utf8_lossy(&bytes[..end]).into_owned();
    let (mut format, mut count, mut in_vertex) = ("", None, false);
    let mut properties: Vec<(String, Scalar)> = Vec::new();
    for line in header.lines() {
        let words: Vec<&str> = line.split_whitespace().collect();
        match words.as_slice() {
            ["format", f, ..] => {
                format = match *f {
                    "ascii" => "ascii",
                    "binary_little_endian" => "little",
                    "binary_big_endian" => "big",
                    _ => return Err(bad("unknown format")),
                }
            }
            ["element", name, n] => {
                if count.is_none() && *name != "vertex" {
                    return Err(bad("the first element is not `vertex`"));
                }
                in_vertex = *name == "vertex";
                if in_vertex {
                    count = Some(n.parse::<usize>().map_err(|_| bad("bad vertex count"))?);
                }
            }
            ["property", "list", ..] if in_vertex => return Err(bad("list property on vertices")),
            ["property", kind, name] if in_vertex => {
                properties.push(((*name).to_owned(), scalar(kind).ok_or_else(|| bad("unknown type"))?));
            }
            _ => {}
        }
    }
    let len = count.ok_or_else(|| bad("no vertices"))?;
    let mut columns: Vec<(String, Vec<f64>)> = properties.iter().map(|p| (p.0.clone(), Vec::new())).collect();
    if format == "ascii" {
        let body = String::from_utf8_lossy(&bytes[body_start..]).into_owned();
        let mut lines = body.lines();
        for _ in 0..len {
            let mut words = lines.next().ok_or_else(|| bad("cut short"))?.split_whitespace();
            for column in &mut columns {
                let value = words.next().and_then(|w| w.parse().ok()).ok_or_else(|| bad("bad number"))?;
                column.1.push(value);
            }
        }
    } else {
        let stride: usize = properties.iter().map(|p| p.1.bytes).sum();
        let needed = len.checked_mul(stride).ok_or_else(|| bad("bad vertex count"))?;
        let body = bytes.get(body_start..body_start + needed).ok_or_else(|| bad("cut short"))?;
        for row in body.chunks_exact(stride.max(1)) {
            let mut at = 0;
            for (column, (_, kind)) in columns.iter_mut().zip(&properties) {
                column.1.push(decode(*kind, &row[at..at + kind.bytes], format == "big"));
                at += kind.bytes;
            }
        }
    }
    Ok(VertexTable { columns, len })
}

impl PointCloud {
    /// Writes the cloud as binary PLY.
    ///
    /// # Errors
    /// [`CoreError::Write`].
    pub fn write_ply(&self, path: &Path) -> Result<(), CoreError> {
        let axis = |v: &[DVec3], i: usize| VertexColumn::F32(v.iter().map(|p| p[i] as f32).collect());
        let channel = |i: usize| VertexColumn::U8(self.colors.iter().map(|c| c[i]).collect());
        let mut columns = vec![
            ("x", axis(&self.points_w, 0)),
            ("y", axis(&self.points_w, 1)),
            ("z", axis(&self.points_w, 2)),
        ];
        if self.normals_w.len() == self.points_w.len() {
            columns.extend((0..3).map(|i| (["nx", "ny", "nz"][i], axis(&self.normals_w, i))));
        }
        if self.colors.len() == self.points_w.len() {
            columns.extend((0..3).map(|i| (["red", "green", "blue"][i], channel(i))));
        }
        write(path, &["frame: world, metres, z up"], &columns)
    }

    /// Reads a cloud, with normals and colours if the file has them.
    ///
    /// # Errors
    /// As [`read`].
    pub fn read_ply(path: &Path) -> Result<Self, CoreError> {
        let table = read(path)?;
        let triple = |names: [&str; 3]| -> Option<Vec<DVec3>> {
            let [x, y, z] = names.map(|n| table.column(n));
            let (x, y, z) = (x?, y?, z?);
            Some((0..table.len).map(|i| DVec3::new(x[i], y[i], z[i])).collect())
        };
        let points_w = triple(["x", "y", "z"]).ok_or_else(|| {
            InputError::new("this PLY has no columns x, y, z", path, "export the cloud with positions")
        })?;
        let colors = triple(["red", "green", "blue"]).or_else(|| triple(["r", "g", "b"])).unwrap_or_default();
        Ok(Self {
            points_w,
            normals_w: triple(["nx", "ny", "nz"]).unwrap_or_default(),
            colors: colors.into_iter().map(|c| c.to_array().map(|v| v.clamp(0.0, 255.0) as u8)).collect(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clouds_round_trip_and_ascii_is_read() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("c.ply");
        let cloud = PointCloud {
            points_w: vec![DVec3::new(0.5, -1.0, 2.0), DVec3::ZERO],
            normals_w: vec![DVec3::Z, DVec3::X],
            colors: vec![[1, 2, 3], [255, 0, 9]],
        };
        cloud.write_ply(&path).unwrap();
        assert_eq!(PointCloud::read_ply(&path).unwrap(), cloud);
        let text = "ply\nformat ascii 1.0\nelement vertex 1\nproperty double x\nproperty float y\n\
                    property int z\nelement face 0\nproperty list uchar int vertex_indices\nend_header\n1.5 2 -3\n";
        std::fs::write(&path, text).unwrap();
        assert_eq!(PointCloud::read_ply(&path).unwrap().points_w, vec![DVec3::new(1.5, 2.0, -3.0)]);
        std::fs::write(&path, text.replace("1.5 2 -3\n", "")).unwrap();
        assert!(matches!(PointCloud::read_ply(&path), Err(CoreError::Input(_))));
    }
}

//! Reader of safetensors files, one tensor at a time.
//!
//! The format is eight bytes of length, little-endian, a JSON object from names to type, shape and byte range, and the
//! bytes. Files come from a download or from the user, so all of their contents are checked.

use crate::NetsError;
use crate::weights::WeightsSource;
use candle_core::{DType, Device, Tensor};
use serde::Deserialize;
use sms_core::{CoreError, InputError};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Mutex;

/// Greatest length of a header in this format.
const MAX_HEADER_BYTES: u64 = 100 << 20;

/// An open file and the places of its tensors.
#[derive(Debug)]
pub(crate) struct SafetensorsFile {
    path: PathBuf,
    file: Mutex<File>,
    entries: BTreeMap<String, TensorEntry>,
    data_start: u64,
}

#[derive(Debug, Clone, Deserialize)]
struct TensorEntry {
    dtype: String,
    shape: Vec<usize>,
    data_offsets: [u64; 2],
}

const DOWNLOAD_AGAIN: &str = "delete the file and fetch it again with `sms models fetch`";

impl SafetensorsFile {
    /// Opens a file and checks its header against its length.
    ///
    /// # Errors
    /// [`NetsError::Input`] if it has another format or is cut off, [`NetsError::Core`] if it cannot be read.
    pub(crate) fn open(path: &Path) -> Result<Self, NetsError> {
        let broken = |what: &str| InputError::new(what, path, DOWNLOAD_AGAIN);
        let damaged = || broken("the header of this weight file is damaged");
        let mut file = File::open(path).map_err(CoreError::read(path))?;
        let length = file.metadata().map_err(CoreError::read(path))?.len();
        let mut head = [0; 8];
        file.read_exact(&mut head).map_err(|e| broken("this weight file is too short").because(e))?;
        let header = u64::from_le_bytes(head);
        if header > MAX_HEADER_BYTES || header + 8 > length {
            let what = "this is not a safetensors file, or it is cut off";
            return Err(broken(what).because(start_of(&head)).into());
        }
        let mut json = vec![0; header as usize];
        file.read_exact(&mut json).map_err(CoreError::read(path))?;
        let raw: BTreeMap<String, serde_json::Value> =
            serde_json::from_slice(&json).map_err(|e| damaged().because(e))?;
        let mut entries = BTreeMap::new();
        for (name, value) in raw.into_iter().filter(|(name, _)| name != "__metadata__") {
            let entry: TensorEntry = serde_json::from_value(value).map_err(|e| damaged().because(e))?;
            let [start, end] = entry.data_offsets;
            let fits = |element: u64| {
                let bytes = entry.shape.iter().try_fold(element, |n, d| n.checked_mul(*d as u64));
                bytes == Some(end - start)
            };
            if start > end || bytes_of(&entry.dtype).is_some_and(|element| !fits(element)) {
                return Err(damaged().because(name).into());
            }
            if end > length - 8 - header {
                let why = format!("`{name}` ends beyond its {length} bytes");
                return Err(broken("this weight file is cut off").because(why).into());
            }
            entries.insert(name, entry);
        }
        Ok(Self { path: path.to_owned(), file: Mutex::new(file), entries, data_start: header + 8 })
    }

    fn bytes(&self, entry: &TensorEntry) -> Result<Vec<u8>, NetsError> {
        let [start, end] = entry.data_offsets;
        let mut bytes = vec![0; (end - start) as usize];
        let mut file = self.file.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        file.seek(SeekFrom::Start(self.data_start + start)).map_err(CoreError::read(&self.path))?;
        file.read_exact(&mut bytes).map_err(CoreError::read(&self.path))?;
        Ok(bytes)
    }
}

impl WeightsSource for SafetensorsFile {
    fn holds(&self, name: &str) -> bool {
        self.entries.contains_key(name)
    }

    fn tensor(&self, name: &str, shape: &[usize], device: &Device) -> Result<Tensor, NetsError> {
        let cure = "the weights belong to another model: choose the matching folder or model";
        let another = |what: String| InputError::new(what, &self.path, cure);
        let entry =
            self.entries.get(name).ok_or_else(|| another(format!("this weight file has no `{name}`")))?;
        if entry.shape != shape {
            let what = format!("`{name}` has the shape {:?} in this weight file, not {shape:?}", entry.shape);
            return Err(another(what).into());
        }
        let dtype = match entry.dtype.as_str() {
            "F32" => DType::F32,
            "F16" => DType::F16,
            "BF16" => DType::BF16,
            "F64" => DType::F64,
            other => return Err(another(format!("`{name}` has the type {other}, not a float type")).into()),
        };
        let raw = Tensor::from_raw_buffer(&self.bytes(entry)?, dtype, shape, &Device::Cpu)?;
        Ok(raw.to_dtype(DType::F32)?.to_device(device)?)
    }
}

/// Returns the bytes of one element.
fn bytes_of(dtype: &str) -> Option<u64> {
    match dtype {
        "F64" | "I64" | "U64" => Some(8),
        "F32" | "I32" | "U32" => Some(4),
        "F16" | "BF16" | "I16" | "U16" => Some(2),
        "U8" | "I8" | "BOOL" => Some(1),
        _ => None,
    }
}

/// Describes the first bytes for the message; common mistakes are a web page and a pickle.
fn start_of(head: &[u8]) -> &'static str {
    match head {
        [b'<', ..] => "it starts like a web page",
        [b'P', b'K', ..] | [0x80, ..] => "it starts like a PyTorch pickle; the safetensors file is needed",
        [b'v', b'e', b'r', b's', ..] => "it is a Git LFS pointer, not the file itself",
        _ => "its length does not fit its header",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(header: &str, data: &[u8]) -> Vec<u8> {
        let mut bytes = (header.len() as u64).to_le_bytes().to_vec();
        bytes.extend_from_slice(header.as_bytes());
        bytes.extend_from_slice(data);
        bytes
    }

    fn open(bytes: &[u8]) -> Result<SafetensorsFile, NetsError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("w.safetensors");
        std::fs::write(&path, bytes).unwrap();
        SafetensorsFile::open(&path)
    }

    const HEADER: &str = r#"{"__metadata__":{"format":"pt"},"a":{"dtype":"F32","shape":[2],"data_offsets":[0,8]},"b":{"dtype":"BF16","shape":[1,1],"data_offsets":[8,10]}}"#;

    #[test]
    fn tensors_of_any_float_type_are_read_and_names_and_shapes_checked() {
        let mut data = Vec::new();
        data.extend_from_slice(&1.5f32.to_le_bytes());
        data.extend_from_slice(&(-2f32).to_le_bytes());
        data.extend_from_slice(&[0x80, 0x3f]);
        let file = open(&file(HEADER, &data)).unwrap();
        let a = file.tensor("a", &[2], &Device::Cpu).unwrap();
        assert_eq!(a.to_vec1::<f32>().unwrap(), [1.5, -2.0]);
        let b = file.tensor("b", &[1, 1], &Device::Cpu).unwrap();
        assert_eq!(b.to_vec2::<f32>().unwrap(), [[1.0]]);
        for (name, shape) in [("c", vec![2]), ("a", vec![1, 2])] {
            let message = file.tensor(name, &shape, &Device::Cpu).unwrap_err().to_string();
            assert!(message.contains(name), "{message}");
        }
    }

    #[test]
    fn every_cut_of_a_file_is_refused() {
        let whole = file(HEADER, &[0; 10]);
        assert!(open(&whole).is_ok());
        for length in 0..whole.len() {
            let error = open(&whole[..length]).expect_err("cut");
            assert!(matches!(error, NetsError::Input(_)), "{length}: {error}");
        }
    }

    #[test]
    fn other_formats_are_named() {
        let page = [b"<!DOCTYPE html>".to_vec(), vec![b'x'; 64]].concat();
        let detail = |bytes: &[u8]| match open(bytes) {
            Err(NetsError::Input(e)) => e.detail().map(str::to_owned),
            other => panic!("{other:?}"),
        };
        let page = detail(&page);
        let pointer = b"version https://git-lfs.github.com/spec/v1".to_vec();
        let pointer = detail(&pointer);
        assert!(page.is_some() && pointer.is_some() && page != pointer);
        let bad = file(r#"{"a":{"dtype":"F32","shape":[3],"data_offsets":[0,8]}}"#, &[0; 8]);
        assert!(matches!(open(&bad), Err(NetsError::Input(_))));
    }
}

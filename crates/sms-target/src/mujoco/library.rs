//! The MuJoCo library, loaded at run time.
//!
//! Only functions are used, because the layout of MuJoCo's structures changes between versions. States are read and set
//! with `mj_getState` and `mj_setState`. Accelerations come from `mj_step`, which stores them as the solver's next warm
//! start, and `mj_integratePos` integrates steps of any length.

use libloading::Library as Dynamic;
use sms_core::InputError;
use std::ffi::{CStr, CString, c_char, c_int, c_void};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, OnceLock, PoisonError};

/// Environment variable with the path of the library or of its folder.
pub const MUJOCO_VARIABLE: &str = "SMS_MUJOCO";

/// Instructions to install the library.
const CURE: &str = "`pip install mujoco`, and set SMS_MUJOCO to its folder: \
                    export SMS_MUJOCO=$(python3 -c 'import mujoco, os; print(os.path.dirname(mujoco.__file__))')";

/// First version with `mj_parseXMLString` and the other functions.
const OLDEST: (i32, i32) = (3, 2);
/// Length of the buffer for MuJoCo's error texts.
const ERROR_LEN: usize = 1000;

/// Components of a state: bits of `mjtState` that are the same in every version.
pub(super) const QPOS: c_int = 1 << 1;
pub(super) const QVEL: c_int = 1 << 2;
/// Bits of `mjtState` that may be further components of a state; each library is queried for their sizes.
const STATE_BITS: std::ops::Range<c_int> = 3..20;

type Opaque = *mut c_void;

/// The functions of MuJoCo in use.
pub(super) struct Library {
    parse_xml: unsafe extern "C" fn(*const c_char, *const c_void, *mut c_char, c_int) -> Opaque,
    compile: unsafe extern "C" fn(Opaque, *const c_void) -> Opaque,
    spec_error: unsafe extern "C" fn(Opaque) -> *const c_char,
    delete_spec: unsafe extern "C" fn(Opaque),
    delete_model: unsafe extern "C" fn(Opaque),
    make_data: unsafe extern "C" fn(Opaque) -> Opaque,
    delete_data: unsafe extern "C" fn(Opaque),
    step: unsafe extern "C" fn(Opaque, Opaque),
    state_size: unsafe extern "C" fn(Opaque, c_int) -> c_int,
    get_state: unsafe extern "C" fn(Opaque, Opaque, *mut f64, c_int),
    set_state: unsafe extern "C" fn(Opaque, Opaque, *const f64, c_int),
    integrate: unsafe extern "C" fn(Opaque, *mut f64, *const f64, f64),
    /// Held while models are compiled: compilation uses caches of the whole process.
    compiling: Mutex<()>,
    version: String,
    // Keeps the code of the functions loaded.
    _dynamic: Dynamic,
}

/// Ignores a warning. MuJoCo's warnings (a full contact buffer, a non-finite state) show in the states, and its default
/// handler prints and writes a log into the working directory.
unsafe extern "C" fn ignore_warning(_text: *const c_char) {}

impl Library {
    /// Returns the library at [`MUJOCO_VARIABLE`]; the first call loads it.
    pub(super) fn get() -> Result<&'static Self, InputError> {
        static LIBRARY: OnceLock<Result<Library, InputError>> = OnceLock::new();
        LIBRARY.get_or_init(Self::find).as_ref().map_err(Clone::clone)
    }

    fn find() -> Result<Self, InputError> {
        let Some(named) = std::env::var_os(MUJOCO_VARIABLE).filter(|v| !v.is_empty()) else {
            return Err(InputError::new("the path of the MuJoCo library is not set", MUJOCO_VARIABLE, CURE));
        };
        let named = PathBuf::from(named);
        let file = if named.is_dir() { in_folder(&named) } else { Some(named.clone()) };
        let file = file
            .filter(|f| f.is_file())
            .ok_or_else(|| InputError::new("no MuJoCo library found", &named, CURE))?;
        Self::load(&file)
            .map_err(|why| InputError::new("the MuJoCo library cannot be used", &file, CURE).because(why))
    }

    fn load(file: &Path) -> Result<Self, String> {
        // SAFETY: loading runs the library's initialisers; the user declared it to be MuJoCo. Each symbol is looked up
        // by its documented name and has the type that the header `mujoco.h` declares, in all versions from `OLDEST`
        // on.
        unsafe {
            let dynamic = Dynamic::new(file).map_err(|e| e.to_string())?;
            macro_rules! function {
                ($name:literal) => {
                    *dynamic
                        .get(concat!($name, "\0").as_bytes())
                        .map_err(|_| format!("it has no function {}", $name))?
                };
            }
            let version_text: unsafe extern "C" fn() -> *const c_char = function!("mj_versionString");
            let version = CStr::from_ptr(version_text()).to_string_lossy().into_owned();
            check_version(&version)?;
            // The library's variable that points to the warning handler.
            let handler = dynamic
                .get::<*mut Option<unsafe extern "C" fn(*const c_char)>>(b"mju_user_warning\0")
                .map_err(|_| "it has no variable mju_user_warning")?;
            **handler = Some(ignore_warning);
            Ok(Self {
                parse_xml: function!("mj_parseXMLString"),
                compile: function!("mj_compile"),
                spec_error: function!("mjs_getError"),
                delete_spec: function!("mj_deleteSpec"),
                delete_model: function!("mj_deleteModel"),
                make_data: function!("mj_makeData"),
                delete_data: function!("mj_deleteData"),
                step: function!("mj_step"),
                state_size: function!("mj_stateSize"),
                get_state: function!("mj_getState"),
                set_state: function!("mj_setState"),
                integrate: function!("mj_integratePos"),
                compiling: Mutex::new(()),
                version,
                _dynamic: dynamic,
            })
        }
    }

    /// Returns the library's version ("4.0.0").
    pub(super) fn version(&self) -> &str {
        &self.version
    }

    /// Compiles a model from MJCF text.
    ///
    /// # Errors
    /// MuJoCo's error message.
    pub(super) fn model(&'static self, xml: &str) -> Result<Model, String> {
        let text = CString::new(xml).map_err(|_| "a name contains a zero byte".to_owned())?;
        let mut error = [0 as c_char; ERROR_LEN];
        let _lock = self.compiling.lock().unwrap_or_else(PoisonError::into_inner);
        // SAFETY: the text is a C string and the error buffer has the length that is passed; MuJoCo ends its texts with
        // a zero. The specification is deleted here; `Model` owns the model.
        unsafe {
            let spec =
                (self.parse_xml)(text.as_ptr(), std::ptr::null(), error.as_mut_ptr(), ERROR_LEN as c_int);
            if spec.is_null() {
                return Err(CStr::from_ptr(error.as_ptr()).to_string_lossy().into_owned());
            }
            let model = (self.compile)(spec, std::ptr::null());
            let why = if model.is_null() {
                CStr::from_ptr((self.spec_error)(spec)).to_string_lossy().into_owned()
            } else {
                String::new()
            };
            (self.delete_spec)(spec);
            if model.is_null() { Err(why) } else { Ok(Model { library: self, model }) }
        }
    }
}

/// Finds the library in a folder; of several, the last by name.
fn in_folder(folder: &Path) -> Option<PathBuf> {
    let is_library = |p: &PathBuf| {
        let name = p.file_name().unwrap_or_default().to_string_lossy().into_owned();
        (name.starts_with("libmujoco") && (name.contains(".so") || name.ends_with(".dylib")))
            || name == "mujoco.dll"
    };
    let files = std::fs::read_dir(folder).ok()?.filter_map(|e| Some(e.ok()?.path()));
    files.filter(is_library).max()
}

fn check_version(version: &str) -> Result<(), String> {
    let mut numbers = version.split('.').map(|n| n.parse::<i32>().unwrap_or(-1));
    let (major, minor) = (numbers.next().unwrap_or(-1), numbers.next().unwrap_or(-1));
    if (major, minor) < OLDEST {
        return Err(format!("its version is {version}; at least {}.{} is required", OLDEST.0, OLDEST.1));
    }
    Ok(())
}

/// A compiled model.
pub(super) struct Model {
    library: &'static Library,
    model: Opaque,
}

// SAFETY: a model does not change after compilation.
unsafe impl Send for Model {}
// SAFETY: as above.
unsafe impl Sync for Model {}

impl Model {
    fn size(&self, bits: c_int) -> usize {
        // SAFETY: a getter of a living model.
        unsafe { (self.library.state_size)(self.model, bits) as usize }
    }

    /// Integrates positions `q` along velocities `v` for `dt` seconds.
    pub(super) fn integrate(&self, q: &mut [f64], v: &[f64], dt: f64) {
        assert!(q.len() == self.size(QPOS) && v.len() == self.size(QVEL), "sizes must match the model");
        // SAFETY: both arrays have the model's lengths.
        unsafe { (self.library.integrate)(self.model, q.as_mut_ptr(), v.as_ptr(), dt) };
    }
}

impl Drop for Model {
    fn drop(&mut self) {
        // SAFETY: owned here; data use it only through an `Arc`.
        unsafe { (self.library.delete_model)(self.model) };
    }
}

/// A state of a model and its derived quantities.
pub(super) struct Data {
    model: std::sync::Arc<Model>,
    data: Opaque,
    /// State bit of the solver's warm start: the accelerations of its last solution.
    acceleration: c_int,
    /// State bit of the forces and torques on bodies.
    wrench: c_int,
}

// SAFETY: only the owning thread uses the data.
unsafe impl Send for Data {}

impl Data {
    /// Allocates the data of a model with `bodies` bodies, including the world.
    ///
    /// # Errors
    /// A reason, if memory is short or the library's state layout is unknown.
    pub(super) fn new(model: std::sync::Arc<Model>, bodies: usize) -> Result<Self, String> {
        let speeds = model.size(QVEL);
        let with_size = |size| STATE_BITS.map(|k| 1 << k).find(|&bit| model.size(bit) == size);
        // The warm start is the first component with the length of the velocities. The wrenches are the only component
        // with six values per body: the world counts as a body but has no velocities.
        let (Some(acceleration), Some(wrench)) = (with_size(speeds), with_size(6 * bodies)) else {
            return Err(format!("MuJoCo {} has an unknown state layout", model.library.version));
        };
        // SAFETY: a living model.
        let data = unsafe { (model.library.make_data)(model.model) };
        if data.is_null() {
            return Err("MuJoCo is out of memory".to_owned());
        }
        Ok(Self { model, data, acceleration, wrench })
    }

    fn get(&self, bit: c_int, into: &mut [f64]) {
        assert_eq!(into.len(), self.model.size(bit), "sizes must match the model");
        // SAFETY: the array has the component's length.
        unsafe { (self.model.library.get_state)(self.model.model, self.data, into.as_mut_ptr(), bit) };
    }

    fn set(&mut self, bit: c_int, from: &[f64]) {
        assert_eq!(from.len(), self.model.size(bit), "sizes must match the model");
        // SAFETY: the array has the component's length.
        unsafe { (self.model.library.set_state)(self.model.model, self.data, from.as_ptr(), bit) };
    }

    /// Sets positions and velocities.
    pub(super) fn set_motion(&mut self, q: &[f64], v: &[f64]) {
        self.set(QPOS, q);
        self.set(QVEL, v);
    }

    /// Sets the forces (N) and torques (N·m) at the centres of mass of all bodies, starting with the world.
    pub(super) fn set_wrenches(&mut self, wrenches: &[f64]) {
        self.set(self.wrench, wrenches);
    }

    /// Computes the accelerations from positions, velocities and wrenches, which must be set again afterwards.
    pub(super) fn accelerations(&mut self, into: &mut [f64]) {
        // SAFETY: data of this model.
        unsafe { (self.model.library.step)(self.model.model, self.data) };
        self.get(self.acceleration, into);
    }

    /// Sets the solver's warm start: the last result of [`Data::accelerations`].
    pub(super) fn set_warm_start(&mut self, accelerations: &[f64]) {
        self.set(self.acceleration, accelerations);
    }

    pub(super) fn model(&self) -> &Model {
        &self.model
    }
}

impl Drop for Data {
    fn drop(&mut self) {
        // SAFETY: owned here.
        unsafe { (self.model.library.delete_data)(self.data) };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn old_versions_are_refused() {
        assert!(check_version("2.3.7").is_err() && check_version("3.1.6").is_err());
        assert!(check_version("3.2.0").is_ok() && check_version("4.0.0").is_ok());
        assert!(check_version("unknown").is_err());
    }
}

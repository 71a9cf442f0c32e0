//! The PhysX SDK of the process, its lock and its errors.

use physx_sys::*;
use std::cell::RefCell;
use std::ffi::{CStr, c_void};
use std::ptr::null_mut;
use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};

/// `PX_PHYSICS_VERSION` of the sources in `physx-sys` 0.11.
const PHYSX_VERSION: u32 = version(5, 1, 3);

/// The SDK: one foundation per process, which is never released (worlds on other threads may outlive any owner).
pub(super) struct Sdk {
    physics: *mut PxPhysics,
    /// Held while objects are created and released. PhysX guards its own tables, but not every path is documented to,
    /// and building a world is short.
    objects: Mutex<()>,
}

// SAFETY: the object lives as long as the process. Calls that change it hold the lock `objects`; all others only read.
unsafe impl Send for Sdk {}
// SAFETY: as above.
unsafe impl Sync for Sdk {}

thread_local! {
    static LAST_ERROR: RefCell<Option<String>> = const { RefCell::new(None) };
}

/// Stores PhysX's error message in place of its default, which prints it.
unsafe extern "C" fn note_error(
    _code: PxErrorCode,
    message: *const i8,
    _file: *const i8,
    _line: u32,
    _user: *const c_void,
) {
    if message.is_null() {
        return;
    }
    // SAFETY: PhysX passes a C string that is valid during the call.
    let text = unsafe { CStr::from_ptr(message.cast()) }.to_string_lossy().into_owned();
    // A terminating thread has no slot any more.
    let _ = LAST_ERROR.try_with(|slot| *slot.borrow_mut() = Some(text));
}

/// Takes PhysX's last error message on this thread.
pub(super) fn take_error() -> Option<String> {
    LAST_ERROR.with(|slot| slot.borrow_mut().take())
}

impl Sdk {
    /// Returns the SDK, which the first call creates.
    ///
    /// # Panics
    /// If the linked PhysX and the headers have different versions, which is a broken build.
    pub(super) fn get() -> &'static Self {
        static SDK: OnceLock<Sdk> = OnceLock::new();
        SDK.get_or_init(|| {
            // SAFETY: called once; the callback is a function, allocator and scale outlive the calls.
            let physics = unsafe {
                let errors = create_error_callback(note_error, null_mut());
                let allocator = get_default_allocator();
                let foundation = phys_PxCreateFoundation(PHYSX_VERSION, allocator.cast(), errors);
                assert!(!foundation.is_null(), "the versions of PhysX and its headers differ");
                let scale = PxTolerancesScale_new(1.0, 10.0);
                phys_PxCreatePhysics(PHYSX_VERSION, foundation, &scale, false, null_mut(), null_mut())
            };
            assert!(!physics.is_null(), "the versions of PhysX and its headers differ");
            Self { physics, objects: Mutex::new(()) }
        })
    }

    pub(super) fn physics(&self) -> *mut PxPhysics {
        self.physics
    }

    pub(super) fn scale(&self) -> *const PxTolerancesScale {
        // SAFETY: a getter of a living object.
        unsafe { PxPhysics_getTolerancesScale(self.physics) }
    }

    /// Returns the lock to hold while objects are created or released.
    pub(super) fn lock(&self) -> MutexGuard<'_, ()> {
        // The lock guards no data that a panic could leave inconsistent.
        self.objects.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Counts the live scenes, shapes of actors, meshes and materials.
    pub(super) fn live_objects(&self) -> usize {
        let _lock = self.lock();
        let p = self.physics;
        // SAFETY: getters of a living object; no object is created meanwhile.
        let counts = unsafe {
            [
                PxPhysics_getNbScenes(p),
                PxPhysics_getNbShapes(p),
                PxPhysics_getNbMaterials(p),
                PxPhysics_getNbConvexMeshes(p),
                PxPhysics_getNbTriangleMeshes(p),
            ]
        };
        counts.iter().map(|&n| n as usize).sum()
    }
}

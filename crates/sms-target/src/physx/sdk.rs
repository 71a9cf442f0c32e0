//! The process's one PhysX, its lock and its errors.

use physx_sys::*;
use std::cell::RefCell;
use std::ffi::{CStr, c_void};
use std::ptr::null_mut;
use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};

/// `PX_PHYSICS_VERSION` of the sources that `physx-sys` 0.11 carries.
const PHYSX_VERSION: u32 = version(5, 1, 3);

/// The SDK: one foundation a process, which is never released (worlds on other threads may outlive any owner).
pub(super) struct Sdk {
    physics: *mut PxPhysics,
    /// Held while objects are created and released. PhysX guards its own tables; that every path of it does is not
    /// documented, and building a world is short.
    objects: Mutex<()>,
}

// SAFETY: the pointer is to an object that lives as long as the process; calls that change it are made under
// `objects`, and the others only read.
unsafe impl Send for Sdk {}
// SAFETY: as above.
unsafe impl Sync for Sdk {}

thread_local! {
    static LAST_ERROR: RefCell<Option<String>> = const { RefCell::new(None) };
}

/// Takes note of what PhysX complains about; its default prints.
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
    // SAFETY: PhysX passes a C string that lives during the call.
    let text = unsafe { CStr::from_ptr(message.cast()) }.to_string_lossy().into_owned();
    // A thread that is being taken down has no slot any more.
    let _ = LAST_ERROR.try_with(|slot| *slot.borrow_mut() = Some(text));
}

/// What PhysX complained about last on this thread, once.
pub(super) fn take_error() -> Option<String> {
    LAST_ERROR.with(|slot| slot.borrow_mut().take())
}

impl Sdk {
    /// The SDK, created at the first call.
    ///
    /// # Panics
    /// When the linked PhysX is another version than the headers; that is a broken build.
    pub(super) fn get() -> &'static Self {
        static SDK: OnceLock<Sdk> = OnceLock::new();
        SDK.get_or_init(|| {
            // SAFETY: called once; the callback is a function, allocator and scale outlive the calls.
            let physics = unsafe {
                let errors = create_error_callback(note_error, null_mut());
                let allocator = get_default_allocator();
                let foundation = phys_PxCreateFoundation(PHYSX_VERSION, allocator.cast(), errors);
                assert!(!foundation.is_null(), "PhysX has another version than its headers");
                let scale = PxTolerancesScale_new(1.0, 10.0);
                phys_PxCreatePhysics(PHYSX_VERSION, foundation, &scale, false, null_mut(), null_mut())
            };
            assert!(!physics.is_null(), "PhysX has another version than its headers");
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

    /// To be held while objects are created or released.
    pub(super) fn lock(&self) -> MutexGuard<'_, ()> {
        // The lock guards no data of ours that a panic could leave half-written.
        self.objects.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Scenes, actors' shapes, meshes and materials that live now.
    pub(super) fn live_objects(&self) -> usize {
        let _lock = self.lock();
        let p = self.physics;
        // SAFETY: getters of a living object; nothing is created meanwhile.
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

//! Collision filtering, and contact modification that lets friction of balls act on velocities alone.

use physx_sys::*;
use std::ffi::c_void;
use std::ptr::from_ref;

/// Collision groups, the first word of a shape's filter data.
pub(super) const GROUP_STATIC: u16 = 1;
pub(super) const GROUP_DYNAMIC: u16 = 2;
pub(super) const GROUP_KINEMATIC: u16 = 3;
pub(super) const GROUP_TOOL: u16 = 4;
/// Second word of the filter data of shapes with contacts that [`on_modify`] modifies.
pub(super) const MODIFIED: u32 = 1;

/// PhysX's default filter, except that kinematic bodies collide neither with each other nor with static ones.
unsafe extern "C" fn filter(info: *mut FilterShaderCallbackInfo) -> PxFilterFlags {
    // SAFETY: PhysX passes a description of the pair that is valid during the call.
    let (first, second, flags) =
        unsafe { ((*info).filterData0, (*info).filterData1, &mut *(*info).pairFlags) };
    let is = |data: &PxFilterData, group: u16| data.word0 == u32::from(group);
    let told = [&first, &second].into_iter().filter(|d| is(d, GROUP_KINEMATIC)).count();
    if told == 2 || (told == 1 && (is(&first, GROUP_STATIC) || is(&second, GROUP_STATIC))) {
        return PxFilterFlags::Suppress;
    }
    *flags = PxPairFlags::ContactDefault;
    if first.word1 == MODIFIED || second.word1 == MODIFIED {
        *flags |= PxPairFlags::ModifyContacts;
    }
    PxFilterFlags::empty()
}

/// Sets the target velocity of each contact to zero. PhysX then solves its friction by velocities. Otherwise it reverts
/// the displacement within the step, which deflects an obliquely struck ball by up to 7° (the slip is reversed instead
/// of stopped).
unsafe extern "C" fn on_modify(_this: *mut c_void, pairs: *mut PxContactModifyPair, count: u32) {
    let zero = PxVec3 { x: 0.0, y: 0.0, z: 0.0 };
    for pair in 0..count as usize {
        // SAFETY: PhysX passes an array of `count` pairs; their contacts are valid during the call.
        unsafe {
            let contacts = &raw mut (*pairs.add(pair)).contacts;
            for index in 0..PxContactSet_size(contacts) {
                PxContactSet_setTargetVelocity_mut(contacts, index, &zero);
            }
        }
    }
}

unsafe extern "C" fn on_drop(_this: *mut c_void) {}

type Modify = unsafe extern "C" fn(*mut c_void, *mut PxContactModifyPair, u32);
type Destructor = unsafe extern "C" fn(*mut c_void);

/// The virtual function table of `PxContactModifyCallback` in the layout of the Itanium C++ ABI: its only method, then
/// both destructors, which PhysX never calls. `physx-sys` can call the method but not implement it.
#[repr(C)]
struct Table {
    on_contact_modify: Modify,
    complete_destructor: Destructor,
    deleting_destructor: Destructor,
}

#[repr(C)]
struct Callback {
    table: &'static Table,
}

static TABLE: Table =
    Table { on_contact_modify: on_modify, complete_destructor: on_drop, deleting_destructor: on_drop };
static CALLBACK: Callback = Callback { table: &TABLE };

/// Sets the filter and the callback in the description of a scene. Contacts are modified if a shape requests it.
pub(super) fn install(description: &mut PxSceneDesc) {
    // SAFETY: writes the description; the filter is a function, and the callback is a constant static.
    unsafe { enable_custom_filter_shader(description, filter, 0) };
    description.contactModifyCallback = from_ref(&CALLBACK).cast_mut().cast();
}

//! A safe interface to the properties of devices and streams; the library has the same three calls for both.
#![allow(unsafe_code)] // Calls of the C library; each with the reason why it is sound.

use super::ffi;
use super::library::{OpenNiError, checked};
use std::ffi::{c_int, c_void};

/// The library's calls for one kind of handle.
pub(super) struct Calls {
    /// Whether a property is known.
    pub is_supported: unsafe extern "C" fn(*mut c_void, c_int) -> c_int,
    /// Reads one: where to, room in bytes and, after the call, bytes that were written.
    pub get: unsafe extern "C" fn(*mut c_void, c_int, *mut c_void, *mut c_int) -> c_int,
    /// Sets one: from where, and bytes of it.
    pub set: unsafe extern "C" fn(*mut c_void, c_int, *const c_void, c_int) -> c_int,
}

/// What has properties.
///
/// # Safety
/// The handle is open as long as `self` lives, and of the kind that the calls take.
pub(super) unsafe trait Properties {
    /// The calls that take its handle.
    const CALLS: Calls;

    /// Its handle.
    fn handle(&self) -> *mut c_void;

    /// Whether it knows a property.
    fn has(&self, property: c_int) -> bool {
        // SAFETY: the handle is open and of the kind that the call takes.
        unsafe { (Self::CALLS.is_supported)(self.handle(), property) != 0 }
    }

    /// A property; `T` is the type that the library's headers give it.
    fn get<T: Value>(&self, property: c_int) -> Option<T> {
        let mut value = T::default();
        let mut size = size_of::<T>() as c_int;
        let at = (&raw mut value).cast();
        // SAFETY: as above; as many bytes may be written as there are, and any are a `T`.
        let status = unsafe { (Self::CALLS.get)(self.handle(), property, at, &raw mut size) };
        (status == ffi::STATUS_OK && size == size_of::<T>() as c_int).then_some(value)
    }

    /// Sets a property.
    ///
    /// # Errors
    /// If it does not take it.
    fn set<T: Value>(&self, property: c_int, value: T, name: &str) -> Result<(), OpenNiError> {
        let (at, size) = ((&raw const value).cast(), size_of::<T>() as c_int);
        // SAFETY: as above; the value is read during the call alone.
        let status = unsafe { (Self::CALLS.set)(self.handle(), property, at, size) };
        checked(status, format!("set {name}"))
    }
}

/// A value of a property: plain bytes, any of which are one.
pub(super) trait Value: Copy + Default {}
impl Value for c_int {}
impl Value for f32 {}
impl Value for ffi::VideoMode {}

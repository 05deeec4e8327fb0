//! The bundled denoiser for C: `include/tauflow_denoise.h` is its manual. No panic crosses the border.

#![expect(unsafe_code, reason = "C passes pointers; each function says what they must be")]

use std::{
    ffi::{CStr, c_char, c_int},
    panic::{AssertUnwindSafe, catch_unwind},
};
use tauflow_contract::KindError;
use tauflow_data::Image;
use tauflow_denoiser::{Denoiser, Frame, Settings, Weights};

/// Loaded models.
pub struct TauflowDenoiser(Denoiser);

/// A frame, as the header declares it.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct TauflowFrame {
    /// In pixels.
    pub width: usize,
    /// In pixels.
    pub height: usize,
    /// [H, W, 3], linear.
    pub radiance: *const f32,
    /// [H, W, 3], or null.
    pub albedo: *const f32,
    /// [H, W, 3], or null.
    pub normal: *const f32,
    /// [H, W, 3], or null.
    pub variance: *const f32,
    /// [H, W, 3], written.
    pub output: *mut f32,
    /// Samples per pixel; 0 if unknown.
    pub spp: u64,
    /// Exposure factor; 0 to measure it.
    pub exposure: f64,
    /// Share of the noisy image that is kept.
    pub keep: f64,
}

/// Runs a function; what it tells, an error, or a panic, becomes a text in `error`.
///
/// # Safety
/// `error` is null, or points at `size` writable bytes.
unsafe fn told<T>(error: *mut c_char, size: usize, f: impl FnOnce() -> Result<(T, String), KindError>) -> Option<T> {
    let (done, message) = match catch_unwind(AssertUnwindSafe(f)) {
        Ok(Ok((value, notes))) => (Some(value), notes),
        Ok(Err(error)) => (None, error.to_string()),
        Err(_) => (None, "an internal error of tauflow".to_owned()),
    };
    if !error.is_null() && size > 0 {
        let bytes = message.as_bytes();
        let count = (0..=bytes.len().min(size - 1)).rev().find(|count| message.is_char_boundary(*count)).unwrap_or(0);
        // SAFETY: the caller says that `size` bytes are writable, and `count` is less.
        unsafe {
            std::ptr::copy_nonoverlapping(bytes.as_ptr().cast(), error, count);
            *error.add(count) = 0;
        }
    }
    done
}

/// The size of a [`TauflowFrame`] in bytes: what a caller was written for can be compared with it.
#[unsafe(no_mangle)]
pub extern "C" fn tauflow_denoiser_frame_size() -> usize {
    size_of::<TauflowFrame>()
}

/// Loads the models of a name.
///
/// # Safety
/// `weights` is null or a text that ends in 0; `error` is null, or points at `error_size` writable bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn tauflow_denoiser_new(
    weights: *const c_char,
    error: *mut c_char,
    error_size: usize,
) -> *mut TauflowDenoiser {
    let load = || {
        // SAFETY: the caller says that it ends in 0.
        let name = if weights.is_null() { c"" } else { unsafe { CStr::from_ptr(weights) } };
        let name = name.to_string_lossy();
        let found = Weights::ALL.into_iter().find(|weights| weights.name() == name);
        let found = found.ok_or_else(|| KindError::Input(format!("no weights `{name}`; use `best` or `fast`")))?;
        Ok((Denoiser::built_in(found)?, String::new()))
    };
    // SAFETY: as the caller says.
    let loaded = unsafe { told(error, error_size, load) };
    loaded.map_or(std::ptr::null_mut(), |denoiser| Box::into_raw(Box::new(TauflowDenoiser(denoiser))))
}

/// Frees loaded models.
///
/// # Safety
/// `denoiser` is null or came from [`tauflow_denoiser_new`], and is not used afterwards.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn tauflow_denoiser_free(denoiser: *mut TauflowDenoiser) {
    if !denoiser.is_null() {
        // SAFETY: it was made by `Box::into_raw`, and the caller gives it up.
        drop(unsafe { Box::from_raw(denoiser) });
    }
}

/// Denoises a frame; 0 if it is done.
///
/// # Safety
/// `denoiser` is null or came from [`tauflow_denoiser_new`]. `frame` is null or points at a frame, whose images are
/// null or have 3 x width x height floats; those of `output` are writable. `error` is null, or points at `error_size`
/// writable bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn tauflow_denoise(
    denoiser: *const TauflowDenoiser,
    frame: *const TauflowFrame,
    error: *mut c_char,
    error_size: usize,
) -> c_int {
    let denoise = || {
        // SAFETY: the caller says that they are null or valid.
        let (denoiser, frame) = unsafe { (denoiser.as_ref(), frame.as_ref()) };
        let (Some(TauflowDenoiser(denoiser)), Some(frame)) = (denoiser, frame) else {
            return Err(KindError::Input("the denoiser or the frame is NULL".into()));
        };
        // SAFETY: as the caller says of the frame.
        let (image, notes) = unsafe { denoised(denoiser, frame) }?;
        // SAFETY: `denoised` refuses a null pointer; otherwise the caller says that it has room for the image. Inputs
        // were copied, so that it may be one of them.
        unsafe { std::ptr::copy_nonoverlapping(image.data().as_ptr(), frame.output, image.data().len()) };
        Ok(((), notes))
    };
    // SAFETY: as the caller says.
    c_int::from(unsafe { told(error, error_size, denoise) }.is_none())
}

/// The frame denoised, and what its pixels tell, a line each.
///
/// # Safety
/// Images are null or have 3 x width x height floats.
unsafe fn denoised(denoiser: &Denoiser, frame: &TauflowFrame) -> Result<(Image, String), KindError> {
    let (width, height) = (frame.width, frame.height);
    let count = width.checked_mul(height).and_then(|pixels| pixels.checked_mul(3));
    let count = count.filter(|count| (3..=isize::MAX as usize / 8).contains(count)).ok_or_else(|| {
        KindError::Input(format!("a frame of {width} x {height} pixels; it needs at least one, and must fit in memory"))
    })?;
    if !(0.0..=1.0).contains(&frame.keep) {
        return Err(KindError::Input(format!("`keep` is {}; it goes from 0 to 1", frame.keep)));
    }
    let image = |pixels: *const f32| -> Result<Image, KindError> {
        // SAFETY: the caller says that it has as many floats, and it is not null.
        let data = unsafe { std::slice::from_raw_parts(pixels, count) }.to_vec();
        Ok(Image::from_data(width, height, 3, data)?)
    };
    if frame.radiance.is_null() || frame.output.is_null() {
        return Err(KindError::Input("`radiance` and `output` must not be NULL".into()));
    }
    let mut given = Frame::new(image(frame.radiance)?)?;
    match (frame.albedo.is_null(), frame.normal.is_null()) {
        (true, true) => {}
        (false, false) => given = given.with_features(image(frame.albedo)?, image(frame.normal)?)?,
        _ => return Err(KindError::Input("`albedo` and `normal` belong together; set both or none".into())),
    }
    if !frame.variance.is_null() {
        given = given.with_variance(image(frame.variance)?, (frame.spp > 0).then_some(frame.spp))?;
    }
    let settings = Settings {
        spp: (frame.spp > 0).then_some(frame.spp),
        exposure: (frame.exposure != 0.0).then_some(frame.exposure),
        strength: 1.0 - frame.keep,
        ..Settings::default()
    };
    let notes = given.notes().join("\n");
    Ok((denoiser.denoise(&given, &settings, &mut |_, _| Ok(()))?.image, notes))
}

//! Open Image Denoise 2, its library loaded at run time: nothing of it is needed to build or to run without it. Which
//! file that is, and what is in it, says [`crate::oidn_files`].
//!
//! Source: the C interface of Open Image Denoise 2.x (`oidn.h`). The only unsafe code of this crate.
//!
//! The library reads and writes memory by address and size. Both come from [`Buffers`] alone, which holds every image
//! of a filter to one size and three channels.

#![expect(unsafe_code, reason = "it calls a C library, and hands it images by address")]

use crate::oidn_files::{self, VARIABLE};
use libloading::Library;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::{
    collections::BTreeMap,
    ffi::{CStr, c_char, c_int, c_void},
    path::{Path, PathBuf},
    sync::{Arc, Mutex, OnceLock},
};
use tauflow_contract::KindError;
use tauflow_data::Image;

const DEVICE_CPU: c_int = 1;
const FLOAT3: c_int = 3;
/// Values of a pixel, as [`FLOAT3`] says.
const CHANNELS: usize = 3;
/// Bytes of a pixel.
const PIXEL: usize = CHANNELS * size_of::<f32>();

type Handle = *mut c_void;

/// The functions that are called.
struct Functions {
    new_device: unsafe extern "C" fn(c_int) -> Handle,
    set_device_int: unsafe extern "C" fn(Handle, *const c_char, c_int),
    get_device_int: unsafe extern "C" fn(Handle, *const c_char) -> c_int,
    commit_device: unsafe extern "C" fn(Handle),
    device_error: unsafe extern "C" fn(Handle, *mut *const c_char) -> c_int,
    release_device: unsafe extern "C" fn(Handle),
    new_filter: unsafe extern "C" fn(Handle, *const c_char) -> Handle,
    set_image: unsafe extern "C" fn(Handle, *const c_char, *mut c_void, c_int, usize, usize, usize, usize, usize),
    set_filter_bool: unsafe extern "C" fn(Handle, *const c_char, bool),
    set_filter_int: unsafe extern "C" fn(Handle, *const c_char, c_int),
    commit_filter: unsafe extern "C" fn(Handle),
    execute_filter: unsafe extern "C" fn(Handle),
    release_filter: unsafe extern "C" fn(Handle),
    /// Keeps them where they are.
    _library: Library,
}

/// The library, loaded.
pub(crate) struct Oidn {
    functions: Functions,
}

/// Loaded libraries by file.
type Loaded = BTreeMap<PathBuf, Arc<Oidn>>;

/// The library of a path or name; of none, that of the variable, or the system's. None if nothing is named and the
/// system has none.
///
/// Loaded once, and never let go of: its threads may outlive any use.
///
/// # Errors
/// If a library is named and there is no such file; if the file that is found cannot be loaded, or is no Open Image
/// Denoise 2.
pub(crate) fn find(named: Option<&str>) -> Result<Option<Arc<Oidn>>, KindError> {
    static LOADED: OnceLock<Mutex<Loaded>> = OnceLock::new();
    let named = oidn_files::named(named);
    let Some(file) = oidn_files::locate(named.as_deref()) else {
        let Some(name) = named else { return Ok(None) };
        return Err(KindError::Environment(format!(
            "the Open Image Denoise library `{name}` does not exist; correct `library` or {VARIABLE}"
        )));
    };
    let mut loaded = LOADED.get_or_init(Mutex::default).lock().expect("no holder panics");
    if let Some(known) = loaded.get(&file) {
        return Ok(Some(known.clone()));
    }
    let library = Arc::new(Oidn::load(&file).map_err(|why| {
        KindError::Environment(format!(
            "cannot load Open Image Denoise from `{}`: {why}; repair it, or select a different library with `library` \
            or {VARIABLE}",
            file.display()
        ))
    })?);
    loaded.insert(file, library.clone());
    Ok(Some(library))
}

impl Oidn {
    fn load(file: &Path) -> Result<Self, String> {
        // SAFETY: loading runs the library's initialisers. The person who names the library, or whose system has one of
        // that name, trusts it as any library that a program links with.
        let library = unsafe { Library::new(file) }.map_err(|e| e.to_string())?;
        macro_rules! function {
            ($name:literal) => {
                // SAFETY: the field's type is what version 2 of the header declares for this name.
                *unsafe { library.get($name) }.map_err(|e| e.to_string())?
            };
        }
        let functions = Functions {
            new_device: function!(b"oidnNewDevice\0"),
            set_device_int: function!(b"oidnSetDeviceInt\0"),
            get_device_int: function!(b"oidnGetDeviceInt\0"),
            commit_device: function!(b"oidnCommitDevice\0"),
            device_error: function!(b"oidnGetDeviceError\0"),
            release_device: function!(b"oidnReleaseDevice\0"),
            new_filter: function!(b"oidnNewFilter\0"),
            set_image: function!(b"oidnSetSharedFilterImage\0"),
            set_filter_bool: function!(b"oidnSetFilterBool\0"),
            set_filter_int: function!(b"oidnSetFilterInt\0"),
            commit_filter: function!(b"oidnCommitFilter\0"),
            execute_filter: function!(b"oidnExecuteFilter\0"),
            release_filter: function!(b"oidnReleaseFilter\0"),
            _library: library,
        };
        let oidn = Self { functions };
        let device = Device::new(&oidn, 1).map_err(|e| e.to_string())?;
        // SAFETY: the device is committed, and the name ends with a zero.
        let version = unsafe { (oidn.functions.get_device_int)(device.handle, c"version".as_ptr()) };
        drop(device);
        // Such as 20501 for 2.5.1.
        if (20000..30000).contains(&version) { Ok(oidn) } else { Err(format!("its version is {version}, not 2.x")) }
    }
}

/// A device of so many threads.
struct Device<'a> {
    oidn: &'a Oidn,
    handle: Handle,
}

impl<'a> Device<'a> {
    /// 0 threads are all.
    fn new(oidn: &'a Oidn, threads: usize) -> Result<Self, KindError> {
        let f = &oidn.functions;
        // SAFETY: the functions are called as the header asks; names end with a zero.
        let device = unsafe {
            let handle = (f.new_device)(DEVICE_CPU);
            if handle.is_null() {
                return Err(KindError::Environment("Open Image Denoise has no device for this processor".into()));
            }
            (f.set_device_int)(handle, c"numThreads".as_ptr(), c_int::try_from(threads).unwrap_or(0));
            (f.commit_device)(handle);
            Self { oidn, handle }
        };
        device.check()?;
        Ok(device)
    }

    /// The last error, if there was one since it was last asked.
    fn check(&self) -> Result<(), KindError> {
        let mut told: *const c_char = std::ptr::null();
        // SAFETY: `told` is a place for a text that lives as long as the device.
        let code = unsafe { (self.oidn.functions.device_error)(self.handle, &raw mut told) };
        if code == 0 {
            return Ok(());
        }
        // SAFETY: with a code other than 0 it is a text that ends with a zero, or null.
        let text = if told.is_null() { "".into() } else { unsafe { CStr::from_ptr(told) }.to_string_lossy() };
        Err(KindError::Environment(format!("Open Image Denoise: error {code}: {text}")))
    }
}

impl Device<'_> {
    /// A committed filter over images of one size, each by its name and the address of its values.
    ///
    /// The caller keeps the images where they are, and of that size, until it has released the filter.
    ///
    /// # Errors
    /// If the library refuses.
    fn filter(
        &self,
        [width, height]: [usize; 2],
        images: impl Iterator<Item = (&'static CStr, *mut f32)>,
        quality: Quality,
        flags: &[(&CStr, bool)],
    ) -> Result<Handle, KindError> {
        let f = &self.oidn.functions;
        // SAFETY: the name ends with a zero.
        let handle = unsafe { (f.new_filter)(self.handle, c"RT".as_ptr()) };
        self.check()?;
        for (name, start) in images {
            // SAFETY: the name ends with a zero. At `start` lie width x height pixels without gaps, which the caller
            // never moves or lets go of before the filter is released.
            unsafe {
                (f.set_image)(handle, name.as_ptr(), start.cast(), FLOAT3, width, height, 0, PIXEL, width * PIXEL);
            }
        }
        // SAFETY: names end with a zero, and all images that were set live as long as the filter.
        unsafe {
            for (name, flag) in flags {
                (f.set_filter_bool)(handle, name.as_ptr(), *flag);
            }
            // The library's own default stays what it is.
            if quality != Quality::High {
                (f.set_filter_int)(handle, c"quality".as_ptr(), quality.number());
            }
            (f.commit_filter)(handle);
        }
        match self.check() {
            Ok(()) => Ok(handle),
            Err(refused) => {
                // SAFETY: it was made by the same library and is not used again.
                unsafe { (f.release_filter)(handle) };
                Err(refused)
            }
        }
    }
}

impl Drop for Device<'_> {
    fn drop(&mut self) {
        // SAFETY: it was made by the same library and is not used again.
        unsafe { (self.oidn.functions.release_device)(self.handle) }
    }
}

/// Quality mode of Open Image Denoise.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Quality {
    /// The best one, for final frames; the default of the library on CPUs.
    #[default]
    High,
    /// For previews.
    Balanced,
    /// For interactive previews; from version 2.3 on.
    Fast,
}

impl Quality {
    /// Its number in the library's header.
    fn number(self) -> c_int {
        match self {
            Self::High => 6,
            Self::Balanced => 5,
            Self::Fast => 4,
        }
    }
}

/// What Open Image Denoise is told of the G-buffer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Features {
    /// That it is free of noise, as it is.
    #[default]
    Clean,
    /// That it is free of noise, after each of its images was denoised by the library.
    Prefiltered,
    /// That it is noisy.
    Raw,
}

/// How a filter works.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Settings {
    pub(crate) quality: Quality,
    pub(crate) features: Features,
}

/// The images that a filter reads and writes, each of width x height pixels of three values.
pub(crate) struct Buffers {
    width: usize,
    height: usize,
    color: Vec<f32>,
    /// Albedo and normal.
    guides: Option<[Vec<f32>; 2]>,
    output: Vec<f32>,
}

impl Buffers {
    /// For an image [H, W, 3] of linear radiance, with a G-buffer [H, W, 6] of albedo and normal.
    ///
    /// # Errors
    /// [`KindError::Input`] if the image has no pixel or another number of channels, or the G-buffer another size.
    pub(crate) fn new(color: &Image, gbuffer: Option<&Image>) -> Result<Self, KindError> {
        let (width, height) = (color.width(), color.height());
        let wrong = |what: &str, image: &Image, wanted: &str| {
            let (w, h, channels) = (image.width(), image.height(), image.channels());
            KindError::Input(format!(
                "the {what} for Open Image Denoise has {w} x {h} pixels of {channels} values and must have {wanted}; \
                 render both alike"
            ))
        };
        if color.channels() != CHANNELS || width == 0 || height == 0 {
            return Err(wrong("image", color, "at least one pixel, of 3 values"));
        }
        if let Some(of) = gbuffer
            && (of.width(), of.height(), of.channels()) != (width, height, 2 * CHANNELS)
        {
            return Err(wrong("G-buffer", of, &format!("the image's {width} x {height} pixels, of 6 values")));
        }
        let guide = |image: &Image, first: usize| image.channels_of(first..first + CHANNELS).into_data();
        let guides = gbuffer.map(|image| [guide(image, 0), guide(image, CHANNELS)]);
        let color = color.data().to_vec();
        let output = vec![0.0; color.len()];
        Ok(Self { width, height, color, guides, output })
    }

    /// Each image by the library's name for it, with the address of its values.
    fn images(&mut self) -> impl Iterator<Item = (&'static CStr, *mut f32)> {
        // Every buffer has as many values as the library is told of.
        let values = CHANNELS * self.width * self.height;
        let [albedo, normal] =
            self.guides.as_mut().map_or([None, None], |[albedo, normal]| [Some(albedo), Some(normal)]);
        [
            (c"color", Some(&mut self.color)),
            (c"albedo", albedo),
            (c"normal", normal),
            (c"output", Some(&mut self.output)),
        ]
        .into_iter()
        .filter_map(|(name, values)| Some((name, values?)))
        .map(move |(name, buffer)| {
            assert_eq!(buffer.len(), values, "buffers are made of one size");
            (name, buffer.as_mut_ptr())
        })
    }
}

/// A filter over images that it holds, with those that denoise its G-buffer first.
pub(crate) struct Filter<'a> {
    /// In the order of their runs; the last one writes the output.
    handles: Vec<Handle>,
    // The buffers of the filters must not move.
    buffers: Buffers,
    /// The G-buffer before it is denoised.
    raw: Option<[Vec<f32>; 2]>,
    device: Device<'a>,
}

impl<'a> Filter<'a> {
    /// For HDR images, on so many threads (0 for all).
    ///
    /// # Errors
    /// If the library refuses.
    pub(crate) fn new(
        oidn: &'a Oidn,
        buffers: Buffers,
        threads: usize,
        Settings { quality, features }: Settings,
    ) -> Result<Self, KindError> {
        let device = Device::new(oidn, threads)?;
        let raw = buffers.guides.clone().filter(|_| features == Features::Prefiltered);
        let mut filter = Self { handles: Vec::new(), buffers, raw, device };
        let clean = filter.buffers.guides.is_some() && features != Features::Raw;
        if let (Some(raw), Some(guides)) = (&mut filter.raw, &mut filter.buffers.guides) {
            let size = [filter.buffers.width, filter.buffers.height];
            for ((name, from), to) in [c"albedo", c"normal"].into_iter().zip(raw).zip(guides) {
                let values = CHANNELS * size[0] * size[1];
                assert_eq!([from.len(), to.len()], [values; 2], "buffers are made of one size");
                let images = [(name, from.as_mut_ptr()), (c"output", to.as_mut_ptr())];
                filter.handles.push(filter.device.filter(size, images.into_iter(), quality, &[])?);
            }
        }
        let size = [filter.buffers.width, filter.buffers.height];
        let flags = [(c"hdr", true), (c"cleanAux", clean)];
        let last = filter.device.filter(size, filter.buffers.images(), quality, &flags)?;
        filter.handles.push(last);
        Ok(filter)
    }

    /// The image, denoised.
    ///
    /// # Errors
    /// If the library fails.
    pub(crate) fn run(&mut self) -> Result<Image, KindError> {
        for handle in &self.handles {
            // SAFETY: the filter is committed, and its images are where they were.
            unsafe { (self.device.oidn.functions.execute_filter)(*handle) };
        }
        self.device.check()?;
        let Buffers { width, height, output, .. } = &self.buffers;
        Ok(Image::from_data(*width, *height, CHANNELS, output.clone())?)
    }
}

impl Drop for Filter<'_> {
    fn drop(&mut self) {
        for handle in &self.handles {
            // SAFETY: it was made by the same library and is not used again.
            unsafe { (self.device.oidn.functions.release_filter)(*handle) }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_of_other_sizes_never_get_to_the_library() {
        let (color, fitting) = (Image::new(4, 2, 3), Image::new(4, 2, 6));
        let refused = |color: &Image, gbuffer: Option<&Image>| match Buffers::new(color, gbuffer) {
            Err(KindError::Input(message)) => message,
            Err(other) => panic!("{other}"),
            Ok(_) => panic!("taken"),
        };
        for gbuffer in [Image::new(1, 1, 6), Image::new(2, 4, 6), Image::new(4, 2, 3), Image::new(4, 2, 12)] {
            let (w, h, channels) = (gbuffer.width(), gbuffer.height(), gbuffer.channels());
            let message = refused(&color, Some(&gbuffer));
            assert!(message.contains(&format!("G-buffer for Open Image Denoise has {w} x {h} pixels of {channels}")));
            assert!(message.contains("the image's 4 x 2 pixels"), "{message}");
        }
        for color in [Image::new(4, 2, 1), Image::new(4, 2, 4), Image::new(0, 2, 3), Image::new(4, 0, 3)] {
            assert!(refused(&color, None).contains("at least one pixel, of 3 values"));
        }
        assert!(Buffers::new(&color, Some(&fitting)).is_ok() && Buffers::new(&color, None).is_ok());
    }

    #[test]
    fn albedo_and_normal_are_images_of_their_own() {
        let color = Image::from_data(2, 1, 3, vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0]).expect("fits");
        let gbuffer = Image::from_data(2, 1, 6, (0..12).map(|i| i as f32).collect()).expect("fits");
        let mut buffers = Buffers::new(&color, Some(&gbuffer)).expect("of one size");
        let [albedo, normal] = buffers.guides.clone().expect("given");
        assert_eq!(buffers.color, color.data());
        assert_eq!(albedo, [0.0, 1.0, 2.0, 6.0, 7.0, 8.0]);
        assert_eq!(normal, [3.0, 4.0, 5.0, 9.0, 10.0, 11.0]);
        let names: Vec<&CStr> = buffers.images().map(|(name, _)| name).collect();
        assert_eq!(names, [c"color", c"albedo", c"normal", c"output"]);
        let mut blind = Buffers::new(&color, None).expect("no G-buffer");
        assert_eq!(blind.images().count(), 2);
    }
}

//! Open Image Denoise 2, its library found at run time: nothing of it is needed to build or to run without it.
//!
//! Source: the C interface of Open Image Denoise 2.x (`oidn.h`). The only unsafe code of this crate.

use libloading::Library;
use std::{
    collections::BTreeMap,
    ffi::{CStr, CString, c_char, c_int, c_void},
    sync::{Arc, Mutex, OnceLock},
};
use tauflow_contract::KindError;
use tauflow_data::Image;

/// Names that systems have for it.
const NAMES: [&str; 4] =
    ["libOpenImageDenoise.so.2", "libOpenImageDenoise.so", "libOpenImageDenoise.2.dylib", "OpenImageDenoise.dll"];
/// Variable that names the library.
pub(crate) const VARIABLE: &str = "TAUFLOW_OIDN";

const DEVICE_CPU: c_int = 1;
const FLOAT3: c_int = 3;
/// Bytes of a value.
const F32: usize = 4;

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
    #[allow(clippy::type_complexity, reason = "the signature is the header's")]
    set_image: unsafe extern "C" fn(Handle, *const c_char, *mut c_void, c_int, usize, usize, usize, usize, usize),
    set_filter_bool: unsafe extern "C" fn(Handle, *const c_char, bool),
    commit_filter: unsafe extern "C" fn(Handle),
    execute_filter: unsafe extern "C" fn(Handle),
    release_filter: unsafe extern "C" fn(Handle),
    /// Keeps them where they are.
    _library: Library,
}

/// The library, loaded.
pub(crate) struct Oidn {
    functions: Functions,
    /// Such as 20501 for 2.5.1.
    pub(crate) version: i64,
}

/// What was found, by what was named.
type Known = BTreeMap<Option<String>, Option<Arc<Oidn>>>;

/// The library of a path or name; of none, that of the variable, or the system's. None if there is none.
///
/// Loaded once, and never let go of: its threads may outlive any use.
///
/// # Errors
/// If a library that was named cannot be loaded, or is no Open Image Denoise 2.
pub(crate) fn find(named: Option<&str>) -> Result<Option<Arc<Oidn>>, KindError> {
    static FOUND: OnceLock<Mutex<Known>> = OnceLock::new();
    let named = named.map(str::to_owned).or_else(|| std::env::var(VARIABLE).ok().filter(|name| !name.is_empty()));
    let mut found = FOUND.get_or_init(Mutex::default).lock().expect("no holder panics");
    if let Some(known) = found.get(&named) {
        return Ok(known.clone());
    }
    let library = match &named {
        Some(name) => Some(Oidn::load(name).map_err(|why| {
            KindError::Environment(format!(
                "cannot load Open Image Denoise from `{name}`: {why}; mend `library`, or {VARIABLE}"
            ))
        })?),
        None => NAMES.iter().find_map(|name| Oidn::load(name).ok()),
    };
    let library = library.map(Arc::new);
    found.insert(named, library.clone());
    Ok(library)
}

impl Oidn {
    fn load(name: &str) -> Result<Self, String> {
        // SAFETY: loading runs the library's initialisers; the person who names the library, or whose system has one of that
        // name, trusts it as any library that a program links with.
        let library = unsafe { Library::new(name) }.map_err(|e| e.to_string())?;
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
            commit_filter: function!(b"oidnCommitFilter\0"),
            execute_filter: function!(b"oidnExecuteFilter\0"),
            release_filter: function!(b"oidnReleaseFilter\0"),
            _library: library,
        };
        let mut oidn = Self { functions, version: 0 };
        let device = Device::new(&oidn, 1).map_err(|e| e.to_string())?;
        // SAFETY: the device is committed, and the name ends with a zero.
        let version = unsafe { (oidn.functions.get_device_int)(device.handle, c"version".as_ptr()) };
        drop(device);
        oidn.version = version.into();
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

impl Drop for Device<'_> {
    fn drop(&mut self) {
        // SAFETY: it was made by the same library and is not used again.
        unsafe { (self.oidn.functions.release_device)(self.handle) }
    }
}

/// A filter for images of one size.
pub(crate) struct Filter<'a> {
    handle: Handle,
    size: (usize, usize),
    // What the filter reads and writes has to stay where it is.
    color: Vec<f32>,
    gbuffer: Option<Vec<f32>>,
    output: Vec<f32>,
    device: Device<'a>,
}

impl<'a> Filter<'a> {
    /// For HDR images of `width` x `height`, on so many threads (0 for all); with a G-buffer [H, W, 6] of albedo and normal,
    /// which are taken for free of noise.
    ///
    /// # Errors
    /// If the library refuses.
    pub(crate) fn new(
        oidn: &'a Oidn,
        gbuffer: Option<&Image>,
        size: (usize, usize),
        threads: usize,
    ) -> Result<Self, KindError> {
        let device = Device::new(oidn, threads)?;
        let f = &oidn.functions;
        // SAFETY: the name ends with a zero.
        let handle = unsafe { (f.new_filter)(device.handle, c"RT".as_ptr()) };
        device.check()?;
        let values = 3 * size.0 * size.1;
        let gbuffer = gbuffer.map(|image| image.data().to_vec());
        let mut filter = Self { handle, size, color: vec![0.0; values], gbuffer, output: vec![0.0; values], device };
        let color = filter.color.as_mut_ptr();
        filter.image("color", color, 3, 0);
        if let Some(gbuffer) = &mut filter.gbuffer {
            let start = gbuffer.as_mut_ptr();
            filter.image("albedo", start, 6, 0);
            filter.image("normal", start, 6, 3);
        }
        let output = filter.output.as_mut_ptr();
        filter.image("output", output, 3, 0);
        // SAFETY: names end with a zero, and all images that were set live as long as the filter.
        unsafe {
            (f.set_filter_bool)(handle, c"hdr".as_ptr(), true);
            (f.set_filter_bool)(handle, c"cleanAux".as_ptr(), filter.gbuffer.is_some());
            (f.commit_filter)(handle);
        }
        filter.device.check()?;
        Ok(filter)
    }

    /// Names an image of `channels` values a pixel, of which three from `first` on are read or written.
    fn image(&self, name: &str, start: *mut f32, channels: usize, first: usize) {
        let name = CString::new(name).expect("no zeros");
        let (width, height) = self.size;
        // SAFETY: the buffers hold height x width x channels values, and are owned by this filter.
        unsafe {
            (self.device.oidn.functions.set_image)(
                self.handle,
                name.as_ptr(),
                start.cast(),
                FLOAT3,
                width,
                height,
                first * F32,
                channels * F32,
                width * channels * F32,
            );
        }
    }

    /// Denoises an image [H, W, 3] of linear radiance.
    ///
    /// # Errors
    /// If the library fails.
    pub(crate) fn run(&mut self, image: &Image) -> Result<Image, KindError> {
        self.color.copy_from_slice(image.data());
        // SAFETY: the filter is committed, and its images are where they were.
        unsafe { (self.device.oidn.functions.execute_filter)(self.handle) };
        self.device.check()?;
        Ok(Image::from_data(self.size.0, self.size.1, 3, self.output.clone())?)
    }
}

impl Drop for Filter<'_> {
    fn drop(&mut self) {
        // SAFETY: it was made by the same library and is not used again.
        unsafe { (self.device.oidn.functions.release_filter)(self.handle) }
    }
}

//! The real Embree, version 3 or 4, loaded when the program runs.
//!
//! Declared after Embree's own headers (`rtcore_*.h`; Wald and others 2014, Embree: A Kernel Framework for Efficient
//! CPU Ray Tracing), as far as a mesh of triangles needs it. The two versions differ in two places: version 3 is handed a
//! context with every query, version 4 optional arguments; and version 4 has one more number in its hits, for
//! which all records here have room behind them.
//!
//! The only file of this package with `unsafe`. What it relies on: the library keeps to its headers, it is never unloaded,
//! and a scene's arrays outlive the scene (the lifetime `'m`).
#![allow(unsafe_code)]

use std::ffi::{CStr, c_char, c_int, c_uint, c_void};
use std::marker::PhantomData;
use std::path::{Path, PathBuf};
use std::ptr::{self, NonNull};
use std::sync::atomic::{AtomicIsize, Ordering};

use libloading::Library;

use crate::scene::Vertices;

/// What can go wrong with Embree.
#[derive(Debug, thiserror::Error)]
pub enum EmbreeError {
    /// There is none where it was looked for.
    #[error(
        "no Embree here ({tried}). Install one: `apt install libembree4-4` (or `libembree3-3`), or \
         `pip download --no-deps embreex==4.4.0.post1 -d wheel && unzip wheel/embreex-*.whl 'embreex.libs/*'`; \
         or say where it is with --library PATH or EMBREE_LIBRARY"
    )]
    Missing {
        /// What the loader said of each place.
        tried: String,
    },
    /// The library lacks a function.
    #[error("{path}: has no {name}: is it Embree 3 or 4?")]
    Symbol {
        /// The library.
        path: PathBuf,
        /// The function.
        name: &'static str,
    },
    /// The library is of another version.
    #[error("{path}: Embree {version}, but only 3 and 4 are understood")]
    Version {
        /// The library.
        path: PathBuf,
        /// Its major version.
        version: isize,
    },
    /// A mesh that cannot be handed out: Embree would read beyond its end.
    #[error("triangle {triangle} has a corner beyond the last of {vertices} vertices")]
    Corner {
        /// The triangle.
        triangle: usize,
        /// How many vertices there are.
        vertices: usize,
    },
    /// Embree refused.
    #[error("Embree: {what} failed: {why}")]
    Refused {
        /// What it was asked for.
        what: &'static str,
        /// Its error code, in words.
        why: &'static str,
    },
}

/// A mesh whose indices have been looked at.
#[derive(Clone, Copy, Debug)]
pub struct Mesh<'m> {
    vertices: &'m Vertices,
    triangles: &'m [[u32; 3]],
}

impl<'m> Mesh<'m> {
    /// Looks at them.
    pub fn new(vertices: &'m Vertices, triangles: &'m [[u32; 3]]) -> Result<Self, EmbreeError> {
        let count = vertices.list().len();
        match triangles.iter().position(|t| t.iter().any(|&v| v as usize >= count)) {
            None => Ok(Self { vertices, triangles }),
            Some(triangle) => Err(EmbreeError::Corner { triangle, vertices: count }),
        }
    }
}

/// How much work to put into a hierarchy.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quality {
    /// Embree's default: binned surface area heuristic.
    Medium,
    /// Spatial splits as well.
    High,
    /// Medium, with `RTC_SCENE_FLAG_COMPACT`: leaves refer to the mesh.
    Compact,
    /// Medium, with `RTC_SCENE_FLAG_ROBUST`: watertight, as ours are.
    Robust,
}

/// A ray for Embree.
#[derive(Clone, Copy, Debug)]
pub struct Beam {
    /// Start, m.
    pub origin: [f32; 3],
    /// Unit direction.
    pub direction: [f32; 3],
    /// Where it ends, m.
    pub far: f32,
}

/// A hit of Embree's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Found {
    /// Distance, m.
    pub t: f32,
    /// Index of the triangle.
    pub triangle: u32,
}

type Handle = NonNull<c_void>;
type Raw = *mut c_void;

/// `RTCRay`.
#[repr(C, align(16))]
struct Ray {
    origin: [f32; 3],
    near: f32,
    direction: [f32; 3],
    time: f32,
    far: f32,
    mask: c_uint,
    id: c_uint,
    flags: c_uint,
}

/// `RTCRayHit`, with room behind.
#[repr(C, align(16))]
struct RayHit {
    ray: Ray,
    normal: [f32; 3],
    uv: [f32; 2],
    primitive: c_uint,
    geometry: c_uint,
    instance: c_uint,
    /// Version 4: `instPrimID`, and padding.
    room: [c_uint; 8],
}

/// `RTCRayHit8` and `RTCRayHit16`, with room behind. They begin with what `RTCRay8` and `RTCRay16` are.
#[repr(C, align(64))]
struct Packet<const N: usize> {
    origin: [[f32; N]; 3],
    near: [f32; N],
    direction: [[f32; N]; 3],
    time: [f32; N],
    far: [f32; N],
    mask: [c_uint; N],
    id: [c_uint; N],
    flags: [c_uint; N],
    normal: [[f32; N]; 3],
    uv: [[f32; N]; 2],
    primitive: [c_uint; N],
    geometry: [c_uint; N],
    instance: [c_uint; N],
    room: [[c_uint; N]; 4],
}

/// `RTCIntersectContext` of version 3 as it is built by default, with room behind.
#[repr(C)]
struct Context {
    flags: c_uint,
    filter: Raw,
    instance: c_uint,
    room: [c_uint; 7],
}

impl Context {
    /// Incoherent rays, no filter.
    fn new() -> Self {
        Self { flags: 0, filter: ptr::null_mut(), instance: INVALID, room: [INVALID; 7] }
    }
}

const INVALID: c_uint = c_uint::MAX;
const FORMAT_UINT3: c_int = 0x5003;
const FORMAT_FLOAT3: c_int = 0x9003;
const BUFFER_INDEX: c_int = 0;
const BUFFER_VERTEX: c_int = 1;
const GEOMETRY_TRIANGLE: c_int = 0;
const PROPERTY_VERSION: c_int = 0;
const QUALITY_MEDIUM: c_int = 1;
const QUALITY_HIGH: c_int = 2;
const FLAG_COMPACT: c_int = 2;
const FLAG_ROBUST: c_int = 4;

/// A query of one ray, as each version declares it.
enum One<R> {
    Three(unsafe extern "C" fn(Raw, *mut Context, *mut R)),
    Four(unsafe extern "C" fn(Raw, *mut R, Raw)),
}

// Derived, they would ask the same of the record.
impl<R> Clone for One<R> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<R> Copy for One<R> {}

impl<R> One<R> {
    /// # Safety
    /// The scene is committed; the record is one of the version's, aligned, and as large as it wants.
    #[inline]
    unsafe fn ask(self, scene: Raw, record: &mut R) {
        // SAFETY: the caller's promise.
        unsafe {
            match self {
                Self::Three(ask) => ask(scene, &mut Context::new(), record),
                Self::Four(ask) => ask(scene, record, ptr::null_mut()),
            }
        }
    }
}

/// A query of `N` rays.
#[derive(Clone, Copy)]
enum Many<const N: usize> {
    Three(unsafe extern "C" fn(*const c_int, Raw, *mut Context, *mut Packet<N>)),
    Four(unsafe extern "C" fn(*const c_int, Raw, *mut Packet<N>, Raw)),
}

impl<const N: usize> Many<N> {
    /// # Safety
    /// The scene is committed.
    #[inline]
    unsafe fn ask(self, valid: &Valid<N>, scene: Raw, packet: &mut Packet<N>) {
        let valid = valid.0.as_ptr();
        // SAFETY: the caller's promise; packet and mask are aligned and at least as large as the version wants.
        unsafe {
            match self {
                Self::Three(ask) => ask(valid, scene, &mut Context::new(), packet),
                Self::Four(ask) => ask(valid, scene, packet, ptr::null_mut()),
            }
        }
    }
}

type Monitor = unsafe extern "C" fn(Raw, isize, bool) -> bool;
type NewDevice = unsafe extern "C" fn(*const c_char) -> Raw;
type LastError = unsafe extern "C" fn(Raw) -> c_int;
type Property = unsafe extern "C" fn(Raw, c_int) -> isize;
/// Releases or commits something.
type Act = unsafe extern "C" fn(Raw);
/// Sets an enumeration.
type Set = unsafe extern "C" fn(Raw, c_int);
type Share = unsafe extern "C" fn(Raw, c_int, c_uint, c_int, *const c_void, usize, usize, usize);

/// The queries.
#[derive(Clone, Copy)]
struct Queries {
    nearest: One<RayHit>,
    occluded: One<Ray>,
    nearest8: Many<8>,
    nearest16: Many<16>,
    occluded8: Many<8>,
    occluded16: Many<16>,
}

/// A loaded library.
#[derive(Clone)]
pub struct Embree {
    path: PathBuf,
    version: (isize, isize, isize),
    queries: Queries,
    new_device: NewDevice,
    release_device: Act,
    device_error: LastError,
    set_monitor: unsafe extern "C" fn(Raw, Monitor, Raw),
    new_scene: unsafe extern "C" fn(Raw) -> Raw,
    release_scene: Act,
    set_quality: Set,
    set_flags: Set,
    new_geometry: unsafe extern "C" fn(Raw, c_int) -> Raw,
    release_geometry: Act,
    set_geometry_quality: Set,
    share: Share,
    commit_geometry: Act,
    attach: unsafe extern "C" fn(Raw, Raw) -> c_uint,
    commit_scene: Act,
}

impl Embree {
    /// Loads a library: `asked` (a file, or a folder that holds one), or the first that is found where the system's
    /// libraries are, in `embreex.libs` here, and in Python's virtual environment.
    pub fn load(asked: Option<&Path>) -> Result<Self, EmbreeError> {
        let mut tried = Vec::new();
        for path in candidates(asked) {
            // SAFETY: loading Embree runs its initialisers, which ask nothing of the caller. The path is
            // the user's own word that this is Embree.
            match unsafe { Library::new(&path) } {
                Ok(library) => {
                    // Never unloaded: function pointers and Embree's threads stay valid.
                    let library: &'static Library = Box::leak(Box::new(library));
                    return on_one_cpu(|| Self::bind(library, path));
                }
                Err(error) => tried.push(error.to_string()),
            }
        }
        if tried.is_empty() {
            tried.push("looked for libembree3 and libembree4".to_owned());
        }
        Err(EmbreeError::Missing { tried: tried.join("; ") })
    }

    fn bind(library: &'static Library, path: PathBuf) -> Result<Self, EmbreeError> {
        /// # Safety
        /// `T` must be the type that Embree's headers give `name`.
        unsafe fn find<T: Copy>(
            library: &'static Library,
            path: &Path,
            name: &'static str,
        ) -> Result<T, EmbreeError> {
            // SAFETY: the caller's promise.
            unsafe { library.get::<T>(name.as_bytes()) }
                .map(|symbol| *symbol)
                .map_err(|_| EmbreeError::Symbol { path: path.into(), name })
        }
        // SAFETY: here and below, the types are those of the headers.
        let (new_device, release_device, device_error, property) = unsafe {
            (
                find::<NewDevice>(library, &path, "rtcNewDevice")?,
                find::<Act>(library, &path, "rtcReleaseDevice")?,
                find::<LastError>(library, &path, "rtcGetDeviceError")?,
                find::<Property>(library, &path, "rtcGetDeviceProperty")?,
            )
        };
        let device = Device::new(new_device, release_device, device_error)?;
        // SAFETY: the device is alive; versions 3 and 4 have this property.
        let version = unsafe { property(device.handle.as_ptr(), PROPERTY_VERSION) };
        drop(device);
        let version = (version / 10_000, version / 100 % 100, version % 100);
        // SAFETY: as above; which types the queries have is what the version says.
        let queries = unsafe {
            match version.0 {
                3 => Queries {
                    nearest: One::Three(find(library, &path, "rtcIntersect1")?),
                    occluded: One::Three(find(library, &path, "rtcOccluded1")?),
                    nearest8: Many::Three(find(library, &path, "rtcIntersect8")?),
                    nearest16: Many::Three(find(library, &path, "rtcIntersect16")?),
                    occluded8: Many::Three(find(library, &path, "rtcOccluded8")?),
                    occluded16: Many::Three(find(library, &path, "rtcOccluded16")?),
                },
                4 => Queries {
                    nearest: One::Four(find(library, &path, "rtcIntersect1")?),
                    occluded: One::Four(find(library, &path, "rtcOccluded1")?),
                    nearest8: Many::Four(find(library, &path, "rtcIntersect8")?),
                    nearest16: Many::Four(find(library, &path, "rtcIntersect16")?),
                    occluded8: Many::Four(find(library, &path, "rtcOccluded8")?),
                    occluded16: Many::Four(find(library, &path, "rtcOccluded16")?),
                },
                version => return Err(EmbreeError::Version { path, version }),
            }
        };
        // SAFETY: as above.
        unsafe {
            Ok(Self {
                version,
                queries,
                new_device,
                release_device,
                device_error,
                set_monitor: find(library, &path, "rtcSetDeviceMemoryMonitorFunction")?,
                new_scene: find(library, &path, "rtcNewScene")?,
                release_scene: find(library, &path, "rtcReleaseScene")?,
                set_quality: find(library, &path, "rtcSetSceneBuildQuality")?,
                set_flags: find(library, &path, "rtcSetSceneFlags")?,
                new_geometry: find(library, &path, "rtcNewGeometry")?,
                release_geometry: find(library, &path, "rtcReleaseGeometry")?,
                set_geometry_quality: find(library, &path, "rtcSetGeometryBuildQuality")?,
                share: find(library, &path, "rtcSetSharedGeometryBuffer")?,
                commit_geometry: find(library, &path, "rtcCommitGeometry")?,
                attach: find(library, &path, "rtcAttachGeometry")?,
                commit_scene: find(library, &path, "rtcCommitScene")?,
                path,
            })
        }
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// `4.4.0`.
    pub fn version(&self) -> String {
        format!("{}.{}.{}", self.version.0, self.version.1, self.version.2)
    }

    /// A device of one thread whose memory is watched.
    pub fn device(&self) -> Result<Device, EmbreeError> {
        let device = Device::new(self.new_device, self.release_device, self.device_error)?;
        let bytes: *const AtomicIsize = &*device.bytes;
        // SAFETY: the device is alive. The counter is boxed in `Device`, which releases the device, and with it
        // the last use of the counter, before the box is freed.
        unsafe { (self.set_monitor)(device.handle.as_ptr(), count, bytes.cast_mut().cast()) };
        Ok(device)
    }

    /// Builds the hierarchy of a mesh, on the calling thread.
    pub fn build<'m>(
        &self,
        device: &'m Device,
        mesh: Mesh<'m>,
        quality: Quality,
    ) -> Result<Scene<'m>, EmbreeError> {
        let (level, flags) = match quality {
            Quality::Medium => (QUALITY_MEDIUM, 0),
            Quality::High => (QUALITY_HIGH, 0),
            Quality::Compact => (QUALITY_MEDIUM, FLAG_COMPACT),
            Quality::Robust => (QUALITY_MEDIUM, FLAG_ROBUST),
        };
        let (list, triangles) = (mesh.vertices.list(), mesh.triangles);
        let before = device.bytes.load(Ordering::Relaxed);
        // SAFETY: handles are used as the headers say, each alive until it is released, and checked for null. The
        // arrays have the formats, strides and counts that are told, indices are in range (`Mesh`), and all live for 'm,
        // longer than the scene; behind the last vertex four more bytes can be read (`Vertices`), which Embree wants.
        let handle = unsafe {
            let scene = NonNull::new((self.new_scene)(device.handle.as_ptr()))
                .ok_or_else(|| device.error("a new scene"))?;
            // From here on dropped, and released, when anything fails.
            let mut scene =
                Scene { embree: self.clone(), handle: scene, bytes: 0, of: PhantomData };
            let geometry =
                NonNull::new((self.new_geometry)(device.handle.as_ptr(), GEOMETRY_TRIANGLE))
                    .ok_or_else(|| device.error("a new geometry"))?
                    .as_ptr();
            let s = scene.handle.as_ptr();
            (self.set_flags)(s, flags);
            (self.set_quality)(s, level);
            let index = triangles.as_ptr().cast();
            (self.share)(geometry, BUFFER_INDEX, 0, FORMAT_UINT3, index, 0, 12, triangles.len());
            let vertex = list.as_ptr().cast();
            (self.share)(geometry, BUFFER_VERTEX, 0, FORMAT_FLOAT3, vertex, 0, 12, list.len());
            (self.set_geometry_quality)(geometry, level);
            (self.commit_geometry)(geometry);
            (self.attach)(s, geometry);
            (self.release_geometry)(geometry);
            (self.commit_scene)(s);
            scene.bytes = device.bytes.load(Ordering::Relaxed) - before;
            scene
        };
        device.check("building")?;
        Ok(handle)
    }
}

/// The monitor: adds up what is allocated and freed.
///
/// # Safety
/// `counter` points to a live `AtomicIsize`.
unsafe extern "C" fn count(counter: Raw, bytes: isize, _after: bool) -> bool {
    // SAFETY: the caller's promise.
    unsafe { &*counter.cast::<AtomicIsize>() }.fetch_add(bytes, Ordering::Relaxed);
    true
}

/// A device of one thread.
pub struct Device {
    handle: Handle,
    release: Act,
    error: LastError,
    /// What Embree holds, by its own account.
    bytes: Box<AtomicIsize>,
}

impl Device {
    fn new(new: NewDevice, release: Act, error: LastError) -> Result<Self, EmbreeError> {
        const ONE_THREAD: &CStr = c"threads=1";
        // SAFETY: a string that ends with zero.
        match NonNull::new(unsafe { new(ONE_THREAD.as_ptr()) }) {
            Some(handle) => Ok(Self { handle, release, error, bytes: Box::default() }),
            // SAFETY: null asks for the error of a device that could not be made.
            None => Err(refused("a new device", unsafe { error(ptr::null_mut()) })),
        }
    }

    fn error(&self, what: &'static str) -> EmbreeError {
        // SAFETY: the device is alive.
        refused(what, unsafe { (self.error)(self.handle.as_ptr()) })
    }

    fn check(&self, what: &'static str) -> Result<(), EmbreeError> {
        // SAFETY: the device is alive.
        match unsafe { (self.error)(self.handle.as_ptr()) } {
            0 => Ok(()),
            code => Err(refused(what, code)),
        }
    }
}

impl Drop for Device {
    fn drop(&mut self) {
        // SAFETY: made in `new`, released once; scenes borrow the device, so none is left.
        unsafe { (self.release)(self.handle.as_ptr()) };
    }
}

fn refused(what: &'static str, code: c_int) -> EmbreeError {
    let why = match code {
        2 => "invalid argument",
        3 => "invalid operation",
        4 => "out of memory",
        5 => "this processor is not supported",
        6 => "cancelled",
        _ => "unknown error",
    };
    EmbreeError::Refused { what, why }
}

/// A committed scene.
pub struct Scene<'m> {
    embree: Embree,
    handle: Handle,
    bytes: isize,
    of: PhantomData<&'m Device>,
}

// SAFETY: a committed scene may be asked by several threads at once; nothing here changes it.
unsafe impl Sync for Scene<'_> {}

impl Scene<'_> {
    /// What the hierarchy takes, by Embree's memory monitor; vertices and indices are the caller's.
    pub fn bytes(&self) -> usize {
        usize::try_from(self.bytes).unwrap_or(0)
    }

    /// `rtcIntersect1`.
    #[inline]
    pub fn nearest(&self, beam: &Beam) -> Option<Found> {
        self.meet(beam).map(|(found, _)| found)
    }

    /// `rtcIntersect1`, with the normal of the triangle that was hit, not of unit length.
    #[inline]
    pub fn meet(&self, beam: &Beam) -> Option<(Found, [f32; 3])> {
        let mut hit = RayHit {
            ray: ray(beam),
            normal: [0.0; 3],
            uv: [0.0; 2],
            primitive: INVALID,
            geometry: INVALID,
            instance: INVALID,
            room: [INVALID; 8],
        };
        // SAFETY: the scene is committed; the record is aligned and as large as the version wants.
        unsafe { self.embree.queries.nearest.ask(self.handle.as_ptr(), &mut hit) };
        let found = Found { t: hit.ray.far, triangle: hit.primitive };
        (hit.geometry != INVALID).then_some((found, hit.normal))
    }

    /// [`meet`](Self::meet) by `rtcIntersect16`, sixteen rays at a time, told in the order of the rays.
    // For `embree-photons` alone.
    #[allow(dead_code)]
    pub fn meet16(&self, beams: &[Beam], mut each: impl FnMut(Option<(Found, [f32; 3])>)) {
        self.packets(self.embree.queries.nearest16, beams, |packet, count| {
            for i in 0..count.min(16) {
                let found = Found { t: packet.far[i], triangle: packet.primitive[i] };
                let normal = [0, 1, 2].map(|axis| packet.normal[axis][i]);
                each((packet.geometry[i] != INVALID).then_some((found, normal)));
            }
        });
    }

    /// `rtcOccluded1`: whether anything is in the way.
    #[inline]
    pub fn occluded(&self, beam: &Beam) -> bool {
        let mut ray = ray(beam);
        // SAFETY: the scene is committed; the record is aligned.
        unsafe { self.embree.queries.occluded.ask(self.handle.as_ptr(), &mut ray) };
        // Minus infinity where something is.
        ray.far < 0.0
    }

    /// `rtcIntersect8`, eight rays at a time; `each` is told the answers in the order of the rays.
    pub fn nearest8(&self, beams: &[Beam], mut each: impl FnMut(Option<Found>)) {
        let query = self.embree.queries.nearest8;
        self.packets(query, beams, |packet, count| scatter(packet, count, &mut each));
    }

    /// `rtcIntersect16`, sixteen rays at a time; `each` is told the answers in the order of the rays.
    pub fn nearest16(&self, beams: &[Beam], mut each: impl FnMut(Option<Found>)) {
        let query = self.embree.queries.nearest16;
        self.packets(query, beams, |packet, count| scatter(packet, count, &mut each));
    }

    /// `rtcOccluded8`, eight rays at a time; `each` is told the answers in the order of the rays.
    pub fn occluded8(&self, beams: &[Beam], mut each: impl FnMut(bool)) {
        self.packets(self.embree.queries.occluded8, beams, |packet, count| {
            packet.far.iter().take(count).for_each(|&far| each(far < 0.0));
        });
    }

    /// `rtcOccluded16`, sixteen rays at a time; `each` is told the answers in the order of the rays.
    pub fn occluded16(&self, beams: &[Beam], mut each: impl FnMut(bool)) {
        self.packets(self.embree.queries.occluded16, beams, |packet, count| {
            packet.far.iter().take(count).for_each(|&far| each(far < 0.0));
        });
    }

    /// Asks about `N` rays at a time; `each` gets the packets, and how many of their rays count.
    #[inline]
    fn packets<const N: usize>(
        &self,
        query: Many<N>,
        beams: &[Beam],
        mut each: impl FnMut(&Packet<N>, usize),
    ) {
        for beams in beams.chunks(N) {
            let (mut packet, valid) = gather::<N>(beams);
            // SAFETY: the scene is committed.
            unsafe { query.ask(&valid, self.handle.as_ptr(), &mut packet) };
            each(&packet, beams.len());
        }
    }
}

impl Drop for Scene<'_> {
    fn drop(&mut self) {
        // SAFETY: made in `build`, released once; its device is still borrowed, so alive.
        unsafe { (self.embree.release_scene)(self.handle.as_ptr()) };
    }
}

#[inline]
fn ray(beam: &Beam) -> Ray {
    Ray {
        origin: beam.origin,
        near: 0.0,
        direction: beam.direction,
        time: 0.0,
        far: beam.far,
        mask: INVALID,
        id: 0,
        flags: 0,
    }
}

/// Which rays of a packet count: -1 or 0.
#[repr(C, align(64))]
struct Valid<const N: usize>([c_int; N]);

/// One to `N` rays, side by side.
#[inline]
fn gather<const N: usize>(beams: &[Beam]) -> (Packet<N>, Valid<N>) {
    let mut packet = Packet {
        origin: [[0.0; N]; 3],
        near: [0.0; N],
        direction: [[0.0; N]; 3],
        time: [0.0; N],
        far: [f32::NEG_INFINITY; N],
        mask: [INVALID; N],
        id: [0; N],
        flags: [0; N],
        normal: [[0.0; N]; 3],
        uv: [[0.0; N]; 2],
        primitive: [INVALID; N],
        geometry: [INVALID; N],
        instance: [INVALID; N],
        room: [[INVALID; N]; 4],
    };
    let mut valid = Valid([0; N]);
    for (i, beam) in beams.iter().enumerate().take(N) {
        for axis in 0..3 {
            packet.origin[axis][i] = beam.origin[axis];
            packet.direction[axis][i] = beam.direction[axis];
        }
        packet.far[i] = beam.far;
        valid.0[i] = -1;
    }
    (packet, valid)
}

#[inline]
fn scatter<const N: usize>(packet: &Packet<N>, count: usize, each: &mut impl FnMut(Option<Found>)) {
    for i in 0..count.min(N) {
        let found = Found { t: packet.far[i], triangle: packet.primitive[i] };
        each((packet.geometry[i] != INVALID).then_some(found));
    }
}

/// Does something with the calling thread on one CPU, where the system can do that.
///
/// Embree's task library counts the CPUs when the first device is made, and starts a worker for each further one. With
/// `threads=1` the worker of embreex 4.4 has nothing to do, and spins for ever: it would take a CPU from both sides.
#[cfg(target_os = "linux")]
fn on_one_cpu<T>(work: impl FnOnce() -> T) -> T {
    use rustix::thread::{CpuSet, sched_getaffinity, sched_getcpu, sched_setaffinity};
    let allowed = sched_getaffinity(None);
    let mut one = CpuSet::new();
    one.set(sched_getcpu());
    // Where it is refused, nothing is lost but a quiet CPU.
    let pinned = allowed.is_ok() && sched_setaffinity(None, &one).is_ok();
    let result = work();
    if let (true, Ok(allowed)) = (pinned, allowed) {
        let _ = sched_setaffinity(None, &allowed);
    }
    result
}

#[cfg(not(target_os = "linux"))]
fn on_one_cpu<T>(work: impl FnOnce() -> T) -> T {
    work()
}

/// Where to look, in this order.
fn candidates(asked: Option<&Path>) -> Vec<PathBuf> {
    match asked {
        Some(path) if path.is_dir() => return libraries(path),
        // Without a slash, the loader would not look here.
        Some(path) if path.is_file() => {
            return vec![std::path::absolute(path).unwrap_or_else(|_| path.to_owned())];
        }
        Some(path) => return vec![path.to_owned()],
        None => {}
    }
    let here = Path::new("embreex.libs");
    let mut places = libraries(here);
    places.extend(libraries(&Path::new(env!("CARGO_MANIFEST_DIR")).join(here)));
    if let Some(environment) = std::env::var_os("VIRTUAL_ENV") {
        for python in entries(&Path::new(&environment).join("lib")) {
            places.extend(libraries(&python.join("site-packages").join(here)));
        }
    }
    // By name alone: wherever the system's loader looks.
    let names = ["libembree4.so.4", "libembree4.so", "libembree3.so.3", "libembree3.so"];
    let names = names.into_iter().chain(["libembree4.dylib", "libembree3.dylib"]);
    places.extend(names.map(PathBuf::from));
    places
}

/// Embree's libraries in a folder, sorted.
fn libraries(folder: &Path) -> Vec<PathBuf> {
    let is_embree = |path: &PathBuf| {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        name.starts_with("libembree") && (name.contains(".so") || name.contains(".dylib"))
    };
    entries(folder).into_iter().filter(is_embree).collect()
}

fn entries(folder: &Path) -> Vec<PathBuf> {
    let mut paths: Vec<PathBuf> = std::fs::read_dir(folder)
        .map(|list| list.flatten().map(|entry| entry.path()).collect())
        .unwrap_or_default();
    paths.sort();
    paths
}

#[cfg(test)]
mod tests {
    use std::mem::{offset_of, size_of};

    use super::*;

    /// Offsets as a C compiler gives them for Embree's headers.
    #[test]
    fn records_are_laid_out_as_in_the_headers() {
        assert_eq!((size_of::<Ray>(), offset_of!(Ray, far)), (48, 32));
        assert_eq!((offset_of!(RayHit, normal), offset_of!(RayHit, primitive)), (48, 68));
        assert_eq!((offset_of!(RayHit, geometry), offset_of!(RayHit, instance)), (72, 76));
        // Version 4 has 96 bytes.
        assert!(size_of::<RayHit>() >= 96);
        assert_eq!(offset_of!(Packet<8>, far), 8 * 32);
        assert_eq!(offset_of!(Packet<8>, normal), 12 * 32);
        assert_eq!(offset_of!(Packet<16>, primitive), 17 * 64);
        assert_eq!(offset_of!(Packet<16>, geometry), 18 * 64);
        assert!(size_of::<Packet<16>>() >= 21 * 64);
        assert_eq!((offset_of!(Context, filter), offset_of!(Context, instance)), (8, 16));
    }

    #[test]
    fn a_library_that_is_not_there_says_how_to_get_it() {
        let error = Embree::load(Some(Path::new("/nonexistent/libembree4.so"))).err().unwrap();
        let text = error.to_string();
        assert!(text.contains("apt install") && text.contains("--library"), "{text}");
        assert!(text.contains("/nonexistent"), "{text}");
        let empty = std::env::temp_dir().join(format!("bench-embree-empty-{}", std::process::id()));
        std::fs::create_dir_all(&empty).unwrap();
        assert!(matches!(Embree::load(Some(&empty)), Err(EmbreeError::Missing { .. })));
        std::fs::remove_dir(&empty).unwrap();
    }

    #[test]
    fn a_corner_that_is_not_there_never_gets_to_embree() {
        let vertices = Vertices::new(vec![[0.0; 3]; 3]);
        let error = Mesh::new(&vertices, &[[0, 1, 2], [0, 1, 3]]).unwrap_err();
        assert_eq!(error.to_string(), "triangle 1 has a corner beyond the last of 3 vertices");
    }

    /// Needs an Embree; says so where there is none.
    #[test]
    fn a_square_is_hit_where_it_is() {
        let asked = std::env::var_os("EMBREE_LIBRARY").map(PathBuf::from);
        let embree = match Embree::load(asked.as_deref()) {
            Ok(embree) => embree,
            Err(EmbreeError::Missing { tried }) if asked.is_none() => {
                eprintln!("SKIPPED: no Embree to ask: {tried}");
                return;
            }
            Err(error) => panic!("{error}"),
        };
        let vertices =
            Vertices::new(vec![[0.0, 0.0, 2.0], [1.0, 0.0, 2.0], [1.0, 1.0, 2.0], [0.0, 1.0, 2.0]]);
        let triangles = [[0, 1, 2], [0, 2, 3]];
        let mesh = Mesh::new(&vertices, &triangles).unwrap();
        for quality in [Quality::Medium, Quality::High, Quality::Compact, Quality::Robust] {
            let device = embree.device().unwrap();
            let scene = embree.build(&device, mesh, quality).unwrap();
            assert!(scene.bytes() > 0 && scene.bytes() < 1 << 20, "{}", scene.bytes());
            // (x, y), and what is hit from z = 0 upwards.
            let beams: Vec<(Beam, Option<Found>)> = (0..37)
                .map(|i| {
                    let (x, y) = (0.11 * i as f32 - 1.3, 0.29);
                    let beam = Beam { origin: [x, y, 0.0], direction: [0.0, 0.0, 1.0], far: 9.0 };
                    let inside = (0.0..=1.0).contains(&x);
                    let triangle = u32::from(y > x);
                    (beam, inside.then_some(Found { t: 2.0, triangle }))
                })
                .collect();
            let list: Vec<Beam> = beams.iter().map(|b| b.0).collect();
            let (mut eight, mut sixteen) = (Vec::new(), Vec::new());
            scene.nearest8(&list, |found| eight.push(found));
            scene.nearest16(&list, |found| sixteen.push(found));
            let mut met16 = Vec::new();
            scene.meet16(&list, |met| met16.push(met));
            let (mut dark8, mut dark16) = (Vec::new(), Vec::new());
            scene.occluded8(&list, |dark| dark8.push(dark));
            scene.occluded16(&list, |dark| dark16.push(dark));
            for (i, (beam, expected)) in beams.iter().enumerate() {
                assert_eq!((dark8[i], dark16[i]), (expected.is_some(), expected.is_some()));
                assert_eq!(scene.nearest(beam), *expected, "{beam:?}");
                let met = scene.meet(beam);
                assert_eq!((met.map(|m| m.0), met16[i]), (*expected, met), "{beam:?}");
                // Along z, either way.
                assert!(met.is_none_or(|(_, n)| n[0] == 0.0 && n[1] == 0.0 && n[2] != 0.0));
                assert_eq!((eight[i], sixteen[i]), (*expected, *expected), "{beam:?}");
                assert_eq!(scene.occluded(beam), expected.is_some(), "{beam:?}");
                let short = Beam { far: 1.9, ..*beam };
                assert!(!scene.occluded(&short) && scene.nearest(&short).is_none());
            }
        }
    }
}

//! glTF 2.0 and GLB: meshes and the nodes that place them, materials, lights, cameras, rooms.
//!
//! A reader of our own, as for OBJ: node transforms stay `f64`, buffers are read block by block (so that
//! a GLB of any size can be spooled), every count is held against the bytes that are there, and errors name
//! the mesh, the primitive and the accessor. (The tests hold it against the crate `gltf`.) Sections in
//! comments are those of the glTF 2.0 specification.

mod data;
mod json;

use crate::{
    InputFile, LoadOptions, SceneError,
    file::LUMENS_PER_WATT,
    input, lamps,
    materials::{DEFAULT_F0, f0_of},
    mtl::Spec,
    obj::{self, Mesh},
    shape::{Builder, Lookup, Part},
    texture::{Map, Source},
};
use data::{Buffer, Items, base64, component, unescaped, value};
use enf_layout::texture::{TEXTURE_CLAMP_X, TEXTURE_CLAMP_Y, TEXTURE_MIRROR_X, TEXTURE_MIRROR_Y};
use glam::{DMat3, DMat4, DQuat, DVec3};
use std::{
    collections::{BTreeMap, BTreeSet},
    f64::consts::PI,
    fs::File,
    os::unix::fs::FileExt,
    path::{Path, PathBuf},
};

/// What stands for a base colour texture that cannot be read, and in the reflectance of metals for any.
const TEXTURE_GREY: f64 = 0.5;
/// Rougher than this, metals and others are matt: a lobe as wide as that is as good as Lambert's, and 1 is what files
/// say that say nothing.
const MATT: f64 = 0.95;
/// Required extensions that change nothing here, or that are understood.
const UNDERSTOOD: [&str; 8] = [
    "KHR_lights_punctual",
    "KHR_mesh_quantization",
    "KHR_texture_transform",
    "KHR_texture_basisu",
    "EXT_texture_webp",
    "EXT_texture_avif",
    "MSFT_texture_dds",
    "KHR_xmp_json_ld",
];

/// What a glTF file holds, in its own coordinates: y up, metres.
pub(crate) struct Model {
    /// The meshes that nodes use.
    pub(crate) meshes: Vec<Mesh>,
    /// Materials by name; every mesh names them so.
    pub(crate) materials: BTreeMap<String, Spec>,
    /// Nodes with a mesh, in the order of a walk down the tree.
    pub(crate) placed: Vec<Placed>,
    pub(crate) lights: Vec<Light>,
    pub(crate) cameras: Vec<Camera>,
    pub(crate) rooms: Vec<Room>,
    pub(crate) inputs: Vec<InputFile>,
    pub(crate) warnings: Vec<String>,
}

/// A node with a mesh.
pub(crate) struct Placed {
    pub(crate) mesh: usize,
    pub(crate) name: String,
    pub(crate) world: DMat4,
}

/// A point light or a spot light.
pub(crate) struct Light {
    pub(crate) name: String,
    pub(crate) position: DVec3,
    /// Where a spot light points, of length 1.
    pub(crate) ahead: DVec3,
    /// Cosines of a spot light's angles.
    pub(crate) cone: Option<[f32; 2]>,
    /// W.
    pub(crate) flux: [f64; 3],
}

/// A perspective camera.
pub(crate) struct Camera {
    pub(crate) name: String,
    pub(crate) eye: DVec3,
    /// Where it looks, of length 1.
    pub(crate) ahead: DVec3,
    /// Its up, of length 1.
    pub(crate) up: DVec3,
    /// Vertical, degrees.
    pub(crate) fov: f64,
}

/// The mesh of a node that is a room.
pub(crate) struct Room {
    pub(crate) name: String,
    pub(crate) triangles: Vec<[DVec3; 3]>,
}

/// A file that is being read.
struct Reader<'a> {
    path: &'a Path,
    root: json::Root,
    buffers: Vec<Buffer>,
    /// All bytes there are.
    bytes: u64,
    warnings: Vec<String>,
    inputs: Vec<InputFile>,
    strict: bool,
    /// Vertices and indices read so far: accessors may be used again, but not without end.
    elements: u64,
}

/// Elements that a file may give for each of its bytes.
const MOST_PER_BYTE: u64 = 16;

/// Reads `.gltf` or `.glb`.
pub(crate) fn read(path: &Path, options: &LoadOptions) -> Result<Model, SceneError> {
    let mut reader = open(path, options)?;
    for extension in &reader.root.extensions_required {
        if !UNDERSTOOD.contains(&extension.as_str()) && !extension.starts_with("KHR_materials_") {
            return Err(SceneError::whole(
                path,
                format!("it requires the extension {}", quoted(extension)),
                "export without it (mesh compression, for one, is not read)",
            ));
        }
    }
    reader.open_buffers()?;
    reader.model(options)
}

/// Some text of the file, fit for a message.
fn quoted(text: &str) -> String {
    format!("\"{}\"", obj::excerpt(text.as_bytes()))
}

/// Reads the JSON, and finds the binary chunk.
fn open<'a>(path: &'a Path, options: &LoadOptions) -> Result<Reader<'a>, SceneError> {
    let fail = |e| SceneError::read(path, e);
    let damaged = |what: String| {
        SceneError::whole(path, what, "the file is damaged or cut short: export it again")
    };
    let input = input::hash_file(path)?;
    let file = File::open(path).map_err(fail)?;
    let size = file.metadata().map_err(fail)?.len();
    let mut head = [0u8; 12];
    let binary = size >= 12 && {
        file.read_exact_at(&mut head, 0).map_err(fail)?;
        head.starts_with(b"glTF")
    };
    let word = |bytes: &[u8]| bytes.iter().rev().fold(0u64, |n, &b| n << 8 | u64::from(b));
    let mut buffers = Vec::new();
    let text = if binary {
        // 4.4: a header of 12 bytes, then chunks of a length, a kind and that many bytes.
        if word(&head[4..8]) != 2 {
            return Err(SceneError::whole(
                path,
                format!("it is GLB version {}", word(&head[4..8])),
                "export it as glTF 2.0",
            ));
        }
        let end = word(&head[8..12]);
        if end > size {
            return Err(damaged(format!("its header says {end} bytes, but it has {size}")));
        }
        let mut at = 12;
        let mut text = None;
        while at + 8 <= end {
            let mut chunk = [0u8; 8];
            file.read_exact_at(&mut chunk, at).map_err(fail)?;
            let length = word(&chunk[..4]);
            at += 8;
            if length > end - at {
                return Err(damaged(format!(
                    "a chunk at byte {} says {length} bytes, but {} are left",
                    at - 8,
                    end - at
                )));
            }
            match &chunk[4..] {
                b"JSON" if text.is_none() => {
                    let mut bytes = vec![0; length as usize];
                    file.read_exact_at(&mut bytes, at).map_err(fail)?;
                    text = Some(bytes);
                }
                b"BIN\0" if buffers.is_empty() => {
                    let file = file.try_clone().map_err(fail)?;
                    buffers.push(Buffer::File { file, path: path.into(), start: at, len: length });
                }
                _ => {}
            }
            at += length;
        }
        text.ok_or_else(|| damaged("it has no JSON chunk".into()))?
    } else {
        let mut bytes = vec![0; size as usize];
        file.read_exact_at(&mut bytes, 0).map_err(fail)?;
        bytes
    };
    let root: json::Root = serde_json::from_slice(&text).map_err(|e| {
        let remedy = "it must be glTF 2.0: export it again";
        let what = e.to_string().replace('\n', " ");
        if binary {
            SceneError::whole(path, format!("its JSON: {what}"), remedy)
        } else {
            SceneError::line(path, e.line().max(1), what, remedy)
        }
    })?;
    if !root.asset.version.starts_with("2.") {
        return Err(SceneError::whole(
            path,
            format!("it is glTF version {}", quoted(&root.asset.version)),
            "export it as glTF 2.0",
        ));
    }
    Ok(Reader {
        path,
        root,
        buffers,
        bytes: size,
        warnings: Vec::new(),
        inputs: vec![input],
        strict: options.strict,
        elements: 0,
    })
}

impl Reader<'_> {
    fn fail<T>(&self, what: impl Into<String>, remedy: &str) -> Result<T, SceneError> {
        Err(SceneError::whole(self.path, what, remedy))
    }

    fn damaged<T>(&self, what: impl Into<String>) -> Result<T, SceneError> {
        self.fail(what, "the file is damaged or badly exported: export it again")
    }

    fn warn(&mut self, what: impl std::fmt::Display) {
        self.warnings.push(format!("{}: {what}", self.path.display()));
    }

    /// Opens what the buffers of the file are in.
    fn open_buffers(&mut self) -> Result<(), SceneError> {
        let binary = self.buffers.pop();
        let mut binary = binary.into_iter();
        let mut buffers = Vec::with_capacity(self.root.buffers.len());
        for (i, said) in self.root.buffers.iter().enumerate() {
            let buffer = match said.uri.as_deref() {
                None if i == 0 => match binary.next() {
                    Some(chunk) => chunk,
                    None => return self.damaged("buffer 0 has no uri, and there is no BIN chunk"),
                },
                None => return self.damaged(format!("buffer {i} has no uri")),
                Some(uri) if uri.starts_with("data:") => {
                    let bytes = match uri.split_once(',') {
                        Some((head, text)) if head.ends_with(";base64") => base64(text),
                        Some((_, text)) => Some(unescaped(text).into_bytes()),
                        None => None,
                    };
                    match bytes {
                        Some(bytes) => Buffer::Memory(bytes),
                        None => return self.damaged(format!("buffer {i} is no base64 data")),
                    }
                }
                Some(uri) => {
                    let folder = self.path.parent().unwrap_or(Path::new(""));
                    let path = folder.join(unescaped(uri));
                    if !path.is_file() {
                        return self.fail(
                            format!("its buffer {} is missing", quoted(uri)),
                            "put the file beside it, or export as .glb",
                        );
                    }
                    self.inputs.push(input::hash_file(&path)?);
                    let file = File::open(&path).map_err(|e| SceneError::read(&path, e))?;
                    let len = file.metadata().map_err(|e| SceneError::read(&path, e))?.len();
                    self.bytes += len;
                    Buffer::File { file, path, start: 0, len }
                }
            };
            if buffer.len() < said.byte_length {
                return self.damaged(format!(
                    "buffer {i} should have {} bytes and has {}",
                    said.byte_length,
                    buffer.len()
                ));
            }
            buffers.push(buffer);
        }
        self.buffers = buffers;
        Ok(())
    }

    /// Items in a buffer view; `None` if they are not all in it.
    fn items(
        &self,
        view: usize,
        offset: u64,
        size: u64,
        count: u64,
        strided: bool,
    ) -> Option<Items<'_>> {
        let view = self.root.buffer_views.get(view)?;
        let buffer = self.buffers.get(view.buffer)?;
        let end = view.byte_offset.checked_add(view.byte_length)?;
        let stride = if strided { view.byte_stride.unwrap_or(size) } else { size };
        if end > buffer.len() || stride < size || count == 0 {
            return None;
        }
        let last = (count - 1).checked_mul(stride)?.checked_add(size)?.checked_add(offset)?;
        (last <= view.byte_length).then_some(Items {
            buffer,
            at: view.byte_offset + offset,
            stride,
            size,
            count,
        })
    }

    /// Calls `f` with the components of each element of an accessor (3.6.2).
    fn each_element<const N: usize>(
        &self,
        index: usize,
        mut f: impl FnMut([f64; N]) -> Result<(), SceneError>,
    ) -> Result<(), SceneError> {
        let Some(a) = self.root.accessors.get(index) else {
            return self.damaged(format!("there is no accessor {index}"));
        };
        let kind = ["SCALAR", "VEC2", "VEC3"][N - 1];
        let Some((bytes, divisor)) = component(a.component_type) else {
            let what = format!("accessor {index} has the component type {}", a.component_type);
            return self.damaged(what);
        };
        if a.kind != kind {
            return self.damaged(format!("accessor {index} is {}, not {kind}", quoted(&a.kind)));
        }
        let size = bytes * N as u64;
        let outside = || format!("accessor {index} has {} elements beyond its buffer", a.count);
        if a.count == 0 {
            return Ok(());
        }
        let decode = |item: &[u8]| -> [f64; N] {
            std::array::from_fn(|c| {
                let v = value(a.component_type, &item[c * bytes as usize..]);
                if a.normalized { (v / divisor).max(-1.0) } else { v }
            })
        };
        // Elements that a sparse accessor replaces (3.6.2.3): ascending.
        let mut replaced: Vec<(u64, [f64; N])> = Vec::new();
        if let Some(sparse) = &a.sparse
            && sparse.count > 0
        {
            let (at, what) = (&sparse.indices, &sparse.values);
            let width = match at.component_type {
                5121 => 1,
                5123 => 2,
                5125 => 4,
                _ => return self.damaged(format!("accessor {index} has bad sparse indices")),
            };
            let indices = self.items(at.buffer_view, at.byte_offset, width, sparse.count, false);
            let values = self.items(what.buffer_view, what.byte_offset, size, sparse.count, false);
            let (Some(indices), Some(values)) = (indices, values) else {
                return self.damaged(outside());
            };
            indices.each(|item| {
                replaced.push((value(at.component_type, item) as u64, [0.0; N]));
                Ok(())
            })?;
            let mut next = 0;
            values.each(|item| {
                replaced[next].1 = decode(item);
                next += 1;
                Ok(())
            })?;
            let ascending = replaced.windows(2).all(|w| w[0].0 < w[1].0);
            if !ascending || replaced.last().is_some_and(|r| r.0 >= a.count) {
                return self.damaged(format!("accessor {index} has bad sparse indices"));
            }
        }
        let mut replaced = replaced.into_iter().peekable();
        let mut number = 0;
        let mut give = |plain: [f64; N]| {
            let v = replaced.next_if(|r| r.0 == number).map_or(plain, |r| r.1);
            number += 1;
            f(v)
        };
        match a.buffer_view {
            Some(view) => {
                let Some(items) = self.items(view, a.byte_offset, size, a.count, true) else {
                    return self.damaged(outside());
                };
                items.each(|item| give(decode(item)))
            }
            // Zeros, but for what is replaced: a count that no file could hold is none.
            None if a.sparse.is_some() && a.count <= self.bytes => {
                (0..a.count).try_for_each(|_| give([0.0; N]))
            }
            None => self.damaged(outside()),
        }
    }

    /// Counts what is about to be read: many primitives could ask for the same elements until memory is
    /// full.
    fn about_to_read(&mut self, mesh: usize) -> Result<(), SceneError> {
        for primitive in self.root.meshes.get(mesh).iter().flat_map(|m| &m.primitives) {
            let coordinates = primitive.attributes.iter().filter(|a| a.0.starts_with("TEXCOORD_"));
            let positions = primitive.attributes.get("POSITION");
            let asked = primitive.indices.iter().chain(positions).chain(coordinates.map(|a| a.1));
            for accessor in asked {
                let count = self.root.accessors.get(*accessor).map_or(0, |a| a.count);
                self.elements = self.elements.saturating_add(count);
            }
        }
        if self.elements > self.bytes.saturating_mul(MOST_PER_BYTE) {
            return self.damaged(format!("mesh {mesh} uses the same elements over and over"));
        }
        Ok(())
    }

    fn model(mut self, options: &LoadOptions) -> Result<Model, SceneError> {
        let (names, materials) = self.materials();
        let nodes = self.nodes()?;
        if self.root.extensions_used.iter().any(|e| e == "EXT_mesh_gpu_instancing") {
            self.warn("instances by EXT_mesh_gpu_instancing are left out; export plain nodes");
        }
        let mut model = Model {
            meshes: Vec::new(),
            materials,
            placed: Vec::new(),
            lights: Vec::new(),
            cameras: Vec::new(),
            rooms: Vec::new(),
            inputs: Vec::new(),
            warnings: Vec::new(),
        };
        let mut ids: BTreeMap<usize, usize> = BTreeMap::new();
        let mut skinned = 0;
        for node in nodes {
            let said = &self.root.nodes[node.index];
            let camera = said.camera;
            let light = said.extensions.light.as_ref().map(|l| l.light);
            let mesh = said.mesh;
            skinned += usize::from(said.skin.is_some() && mesh.is_some());
            if let Some(camera) = camera {
                self.camera(camera, &node, &mut model)?;
            }
            if let Some(light) = light {
                self.light(light, &node, &mut model)?;
            }
            let Some(mesh) = mesh else {
                if node.room {
                    self.warn(format!("the room {} has no mesh: no hint", quoted(&node.name)));
                }
                continue;
            };
            if node.room {
                let room = self.room(mesh, &node, &names, options)?;
                model.rooms.push(room);
                continue;
            }
            let determinant = DMat3::from_mat4(node.world).determinant();
            if determinant == 0.0 || !determinant.is_finite() {
                self.warn(format!(
                    "the node {} is scaled to nothing and left out",
                    quoted(&node.name)
                ));
                continue;
            }
            let id = match ids.get(&mesh) {
                Some(&id) => id,
                None => {
                    let read = self.mesh(mesh, &names, options)?;
                    model.meshes.push(read);
                    ids.insert(mesh, model.meshes.len() - 1);
                    model.meshes.len() - 1
                }
            };
            model.placed.push(Placed { mesh: id, name: node.name, world: node.world });
        }
        if skinned > 0 {
            self.warn(format!("{skinned} nodes have a skin, which is not applied"));
        }
        model.inputs = self.inputs;
        model.warnings = self.warnings;
        Ok(model)
    }

    /// Names of the materials, made unique, and what they are.
    fn materials(&self) -> (Vec<String>, BTreeMap<String, Spec>) {
        let mut names = Vec::with_capacity(self.root.materials.len());
        let mut all = BTreeMap::new();
        for (i, m) in self.root.materials.iter().enumerate() {
            let base = match m.name.as_deref() {
                None | Some("") => format!("material {i}"),
                Some(name) => name.to_string(),
            };
            let name = if all.contains_key(&base) { format!("{base} ({i})") } else { base };
            let mut said = spec(m);
            match m.pbr_metallic_roughness.base_color_texture.as_ref().map(|t| self.picture(t)) {
                Some(Some(Ok(map))) => {
                    // The picture in place of the grey that stands for it.
                    said.kd = said.kd.map(|kd| kd.map(|v| (v / TEXTURE_GREY).min(1.0)));
                    said.map_kd = Some(map);
                }
                Some(Some(Err(path))) => said.lost_map = Some(path),
                Some(None) => said.lost_map = Some(self.path.into()),
                None => {}
            }
            all.insert(name.clone(), said);
            names.push(name);
        }
        (names, all)
    }

    /// The picture of a texture (3.8): `None` where the file says nothing that is read here, or the file that is missing.
    fn picture(&self, used: &json::TextureUse) -> Option<Result<Map, PathBuf>> {
        let texture = self.root.textures.get(used.index)?;
        let image = self.root.images.get(texture.source?)?;
        let source = match (&image.uri, image.buffer_view) {
            (Some(uri), _) if uri.starts_with("data:") => {
                let bytes = uri.split_once(";base64,").and_then(|(_, text)| base64(text))?;
                Source::Memory { path: self.path.into(), bytes }
            }
            (Some(uri), _) => {
                let path = self.path.parent().unwrap_or(Path::new("")).join(unescaped(uri));
                if !path.is_file() {
                    return Some(Err(path));
                }
                Source::File { path, start: 0, len: None }
            }
            (None, view) => {
                let view = self.root.buffer_views.get(view?)?;
                let buffer = self.buffers.get(view.buffer)?;
                buffer.source(self.path, view.byte_offset, view.byte_length)?
            }
        };
        let sampler = texture.sampler.and_then(|s| self.root.samplers.get(s));
        let mut flags = 0;
        for (wrap, clamp, mirror) in [
            (sampler.and_then(|s| s.wrap_s), TEXTURE_CLAMP_X, TEXTURE_MIRROR_X),
            (sampler.and_then(|s| s.wrap_t), TEXTURE_CLAMP_Y, TEXTURE_MIRROR_Y),
        ] {
            flags |= match wrap {
                Some(33071) => clamp,
                Some(33648) => mirror,
                _ => 0,
            };
        }
        // KHR_texture_transform: scaled, then turned, then moved; v points down already.
        let mut place = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        if let Some(t) = &used.extensions.transform {
            let [sx, sy] = t.scale.unwrap_or([1.0; 2]);
            let [ox, oy] = t.offset.unwrap_or([0.0; 2]);
            let (sin, cos) = libm::sincosf(t.rotation.unwrap_or(0.0));
            place = [[cos * sx, sin * sy, ox], [-sin * sx, cos * sy, oy]];
        }
        place.iter().flatten().all(|v| v.is_finite()).then_some(Ok(Map { source, flags, place }))
    }

    /// The nodes of the scene, parents before children (3.5).
    fn nodes(&mut self) -> Result<Vec<Node>, SceneError> {
        let count = self.root.nodes.len();
        let roots: Vec<usize> =
            match self.root.scene.or((!self.root.scenes.is_empty()).then_some(0)) {
                Some(scene) => match self.root.scenes.get(scene) {
                    Some(scene) => scene.nodes.clone(),
                    None => return self.damaged(format!("there is no scene {scene}")),
                },
                None => {
                    let children: BTreeSet<usize> =
                        self.root.nodes.iter().flat_map(|n| n.children.iter().copied()).collect();
                    (0..count).filter(|n| !children.contains(n)).collect()
                }
            };
        let mut seen = vec![false; count];
        let mut out: Vec<Node> = Vec::new();
        let mut stack: Vec<(usize, DMat4, Option<usize>)> =
            roots.into_iter().rev().map(|n| (n, DMat4::IDENTITY, None)).collect();
        while let Some((index, parent, above)) = stack.pop() {
            let Some(said) = self.root.nodes.get(index) else {
                return self.damaged(format!("there is no node {index}"));
            };
            if std::mem::replace(&mut seen[index], true) {
                return self.damaged(format!("node {index} is placed twice; nodes form a tree"));
            }
            let Some(local) = transform(said) else {
                return self.damaged(format!("the transform of node {index} is not finite"));
            };
            let world = parent * local;
            if !world.is_finite() {
                return self.damaged(format!("the transform of node {index} is not finite"));
            }
            let mesh_name = said.mesh.and_then(|m| self.root.meshes.get(m)?.name.clone());
            let own = said.name.clone().filter(|n| !n.is_empty());
            let from_above = above.map(|a| out[a].name.clone());
            let name = own
                .clone()
                .or_else(|| mesh_name.filter(|n| !n.is_empty()))
                .or(from_above)
                .unwrap_or_else(|| format!("node {index}"));
            let (room, name) = room_name(said, own.as_deref(), name);
            out.push(Node { index, name, world, room });
            let here = out.len() - 1;
            stack.extend(said.children.iter().rev().map(|&c| (c, world, Some(here))));
        }
        Ok(out)
    }

    /// Reads a mesh: its primitives one after the other.
    fn mesh(
        &mut self,
        index: usize,
        names: &[String],
        options: &LoadOptions,
    ) -> Result<Mesh, SceneError> {
        self.about_to_read(index)?;
        let Some(said) = self.root.meshes.get(index) else {
            return self.damaged(format!("there is no mesh {index}"));
        };
        let label = match &said.name {
            Some(name) => format!("mesh {index} {}", quoted(name)),
            None => format!("mesh {index}"),
        };
        let mut mesh = Mesh { file: self.path.into(), objects: vec![None], ..Mesh::default() };
        let mut shape = Builder::new(options.spool.as_ref());
        let mut vertices = 0u32;
        // Where the vertices of an accessor begin, and how many they are: primitives may share them.
        let mut bases: BTreeMap<usize, (u32, u32)> = BTreeMap::new();
        let mut locals: BTreeMap<Option<usize>, u32> = BTreeMap::new();
        let (mut not_finite, mut lines, mut ragged, mut morphed) = (0u64, 0u64, 0u64, 0u64);
        for (p, primitive) in said.primitives.iter().enumerate() {
            let place = format!("{label}, primitive {p}");
            let mode = primitive.mode.unwrap_or(4);
            if mode > 6 {
                return self.damaged(format!("{place} has the mode {mode}"));
            }
            if mode < 4 {
                lines += 1;
                continue;
            }
            if let Some(packed) = primitive.extensions.keys().find(|k| k.contains("draco")) {
                return self.fail(
                    format!("{place} is compressed by {}", quoted(packed)),
                    "export without mesh compression",
                );
            }
            morphed += u64::from(!primitive.targets.is_empty());
            let Some(&positions) = primitive.attributes.get("POSITION") else {
                return self.damaged(format!("{place} has no POSITION"));
            };
            let (base, count) = match bases.get(&positions) {
                Some(&known) => known,
                None => {
                    let base = vertices;
                    self.each_element::<3>(positions, |xyz| {
                        let p = DVec3::from_array(xyz);
                        if obj::fits(p) {
                            mesh.note(p);
                        } else {
                            not_finite += 1;
                        }
                        if vertices >= i32::MAX as u32 {
                            return Err(too_many(self.path, &place));
                        }
                        vertices += 1;
                        shape.push_vertex(xyz)
                    })?;
                    bases.insert(positions, (base, vertices - base));
                    (base, vertices - base)
                }
            };
            let material = match primitive.material {
                None => None,
                Some(m) if m < names.len() => Some(m),
                Some(m) => {
                    return self.damaged(format!("{place} uses material {m}, which is none"));
                }
            };
            let used = material.and_then(|m| {
                self.root.materials[m].pbr_metallic_roughness.base_color_texture.as_ref()
            });
            let set = used.map(|t| {
                let over = t.extensions.transform.as_ref().and_then(|t| t.tex_coord);
                format!("TEXCOORD_{}", over.unwrap_or(t.tex_coord))
            });
            let mut places = None;
            if let Some(&accessor) = set.and_then(|set| primitive.attributes.get(&set)) {
                let mut read = Builder::new(options.spool.as_ref());
                self.each_element::<2>(accessor, |[u, v]| read.push_vertex([u, v, 0.0]))?;
                places = Some(read);
            }
            let materials = &mut mesh.materials;
            let material = *locals.entry(material).or_insert_with(|| {
                materials.push(material.map(|m| names[m].clone()));
                materials.len() as u32 - 1
            });
            let part = Part { end: 0, object: 0, material, door: false };
            let mut cutter = Cutter::new(mode);
            let mut add = |index: f64| {
                if index >= f64::from(count) {
                    return Err(SceneError::whole(
                        self.path,
                        format!("{place} uses vertex {index} of {count}"),
                        "the file is damaged or badly exported: export it again",
                    ));
                }
                if let Some(corners) = cutter.next(base + index as u32) {
                    let textured = places.as_mut();
                    if shape.triangles() >= i32::MAX as u64 {
                        return Err(too_many(self.path, &place));
                    }
                    shape.push_triangle(corners, part)?;
                    if let Some(places) = textured {
                        let mut at = [[f32::NAN; 2]; 3];
                        for (at, corner) in at.iter_mut().zip(corners) {
                            if let Some([u, v, _]) = places.position(corner - base)? {
                                *at = [u as f32, v as f32];
                            }
                        }
                        if at.iter().flatten().all(|c| c.is_finite()) {
                            shape.push_coordinates(at)?;
                        }
                    }
                }
                Ok(())
            };
            match primitive.indices {
                Some(indices) => {
                    let kind = self.root.accessors.get(indices).map(|a| a.component_type);
                    if !matches!(kind, None | Some(5121 | 5123 | 5125)) {
                        return self.damaged(format!("{place} has indices that are not unsigned"));
                    }
                    self.each_element::<1>(indices, |[index]| add(index))?;
                }
                None => (0..count).try_for_each(|i| add(f64::from(i)))?,
            }
            ragged += u64::from(cutter.left_over());
        }
        mesh.shape = shape.finish()?;
        for (n, what) in [
            (lines, "primitives are points or lines and left out"),
            (ragged, "primitives end within a triangle; that one is left out"),
            (morphed, "primitives have morph targets, which are not applied"),
        ] {
            if n > 0 {
                self.warn(format!("{label}: {n} {what}"));
            }
        }
        if ragged > 0 && self.strict {
            return self.damaged(format!("{label}: a primitive ends within a triangle"));
        }
        if not_finite > 0 {
            self.warn(format!(
                "{label}: {not_finite} vertices are not finite; their triangles are left out"
            ));
        }
        Ok(mesh)
    }

    /// A room's mesh, where the node puts it.
    fn room(
        &mut self,
        mesh: usize,
        node: &Node,
        names: &[String],
        options: &LoadOptions,
    ) -> Result<Room, SceneError> {
        let mesh = self.mesh(mesh, names, options)?;
        let mut triangles = Vec::new();
        let mut lookup = Lookup::<DVec3>::default();
        for t in 0..mesh.shape.triangles() as u32 {
            let corners = lookup.triangle(&mesh.shape, t)?;
            let mut points = [DVec3::ZERO; 3];
            for (point, v) in points.iter_mut().zip(corners) {
                let p = lookup.vertex(&mesh.shape, v, DVec3::from_array)?;
                *point = node.world.transform_point3(p);
            }
            triangles.push(points);
        }
        Ok(Room { name: node.name.clone(), triangles })
    }

    fn light(&mut self, light: usize, node: &Node, model: &mut Model) -> Result<(), SceneError> {
        let Some(said) = self.root.extensions.lights.lights.get(light) else {
            return self.damaged(format!("there is no light {light}"));
        };
        let name = said.name.clone().filter(|n| !n.is_empty());
        let name = name.unwrap_or_else(|| node.name.clone());
        let color = said.color.unwrap_or([1.0; 3]);
        let candela = said.intensity.unwrap_or(1.0);
        let cone = match (said.kind.as_str(), &said.spot) {
            ("point", _) => None,
            ("spot", said) => {
                // The specification's defaults: 0 and 45 degrees.
                let inner = said.as_ref().and_then(|s| s.inner).unwrap_or(0.0).to_degrees();
                let outer = said.as_ref().and_then(|s| s.outer).map_or(45.0, f64::to_degrees);
                match lamps::cone(inner, outer.min(180.0)) {
                    Ok(cone) => Some(cone),
                    Err(e) => {
                        return self.damaged(format!("the spot light {}: {e}", quoted(&name)));
                    }
                }
            }
            (kind, _) => {
                let what = format!(
                    "the {} light {} is left out: only point and spot lights are read; a lamp may also be \
                     a mesh with an emissive material",
                    obj::excerpt(kind.as_bytes()),
                    quoted(&name)
                );
                self.warn(what);
                return Ok(());
            }
        };
        let flux = match cone {
            None => color.map(|c| c * candela * 4.0 * PI / LUMENS_PER_WATT),
            Some(cone) => lamps::spot_flux(color.map(|c| c * candela), cone),
        };
        if flux.iter().any(|w| !(0.0..=1e20).contains(w)) {
            return self
                .damaged(format!("the intensity of light {} is out of range", quoted(&name)));
        }
        if flux.iter().any(|&w| w > 0.0) {
            let position = node.world.w_axis.truncate();
            // It points along the node's -z, whatever the node's scale.
            let ahead = -node.world.z_axis.truncate().normalize_or(DVec3::Z);
            model.lights.push(Light { name, position, ahead, cone, flux });
        }
        Ok(())
    }

    fn camera(&mut self, camera: usize, node: &Node, model: &mut Model) -> Result<(), SceneError> {
        let Some(said) = self.root.cameras.get(camera) else {
            return self.damaged(format!("there is no camera {camera}"));
        };
        // 3.10: it looks along its -z, and +y is up.
        let linear = DMat3::from_mat4(node.world);
        let ahead = (linear * DVec3::NEG_Z).try_normalize();
        let up = (linear * DVec3::Y).try_normalize();
        let fov = said.perspective.as_ref().map(|p| p.yfov.to_degrees());
        let name = said.name.clone().filter(|n| !n.is_empty());
        let given = &self.root.nodes[node.index].name;
        let name = given.clone().or(name).unwrap_or_else(|| node.name.clone());
        match (ahead, up, fov) {
            (Some(ahead), Some(up), Some(fov))
                if said.kind == "perspective"
                    && (0.1..=175.0).contains(&fov)
                    && ahead.cross(up).length() > 1e-6 =>
            {
                let eye = node.world.w_axis.truncate();
                model.cameras.push(Camera { name, eye, ahead, up, fov });
            }
            _ => self.warn(format!(
                "the camera {} is left out: only perspective cameras of 0.1 to 175 degrees are read",
                quoted(&name)
            )),
        }
        Ok(())
    }
}

fn too_many(path: &Path, place: &str) -> SceneError {
    SceneError::whole(
        path,
        format!("{place} makes more than 2^31 vertices or triangles of one mesh"),
        "split the mesh",
    )
}

/// A node on its way into the scene.
struct Node {
    index: usize,
    name: String,
    world: DMat4,
    room: bool,
}

/// Is it a room? By `extras`, or by its own name; and what it is called.
fn room_name(node: &json::Node, own: Option<&str>, name: String) -> (bool, String) {
    use serde_json::Value;
    match node.extras.as_ref().and_then(|e| e.get("room")) {
        Some(Value::Bool(room)) => return (*room, name),
        Some(Value::String(said)) if !said.is_empty() => return (true, said.clone()),
        _ => {}
    }
    let Some(own) = own else { return (false, name) };
    for (start, cut) in [("Room:", true), ("Room/", true), ("IfcSpace", false)] {
        let Some(rest) = own.strip_prefix(start) else { continue };
        let rest = rest.trim();
        if cut && !rest.is_empty() {
            return (true, rest.to_string());
        }
        // IfcSpaceHeater is none, and IfcSpaceType has no place.
        if !cut && !rest.starts_with(|c: char| c.is_ascii_alphanumeric()) {
            return (true, name);
        }
    }
    (false, name)
}

/// A node's own transform (3.5.3), or `None` if it is not finite.
fn transform(node: &json::Node) -> Option<DMat4> {
    if let Some(m) = node.matrix {
        let mut m = DMat4::from_cols_array(&m);
        // An affine one, whatever rounding left in the last row.
        (m.x_axis.w, m.y_axis.w, m.z_axis.w, m.w_axis.w) = (0.0, 0.0, 0.0, 1.0);
        return m.is_finite().then_some(m);
    }
    let rotation = DQuat::from_array(node.rotation.unwrap_or([0.0, 0.0, 0.0, 1.0]));
    let scale = DVec3::from_array(node.scale.unwrap_or([1.0; 3]));
    let translation = DVec3::from_array(node.translation.unwrap_or([0.0; 3]));
    let length = rotation.length();
    if !(length > 0.0 && length.is_finite() && scale.is_finite() && translation.is_finite()) {
        return None;
    }
    let turn = DMat3::from_quat(rotation / length);
    let linear =
        DMat3::from_cols(turn.x_axis * scale.x, turn.y_axis * scale.y, turn.z_axis * scale.z);
    let mut out = DMat4::from_mat3(linear);
    out.w_axis = translation.extend(1.0);
    Some(out)
}

/// Cuts lists, strips and fans (3.7.2.1) into triangles, vertex by vertex.
struct Cutter {
    mode: u32,
    seen: u64,
    first: u32,
    last: [u32; 2],
}

impl Cutter {
    fn new(mode: u32) -> Self {
        Self { mode, seen: 0, first: 0, last: [0; 2] }
    }

    fn next(&mut self, v: u32) -> Option<[u32; 3]> {
        let i = self.seen;
        self.seen += 1;
        let [a, b] = self.last;
        if i == 0 {
            self.first = v;
        }
        self.last = [b, v];
        if i < 2 {
            return None;
        }
        match self.mode {
            4 => (i % 3 == 2).then_some([a, b, v]),
            // Every other triangle is turned over.
            5 if i.is_multiple_of(2) => Some([a, b, v]),
            5 => Some([a, v, b]),
            _ => Some([b, v, self.first]),
        }
    }

    /// The last triangle is not complete.
    fn left_over(&self) -> bool {
        if self.mode == 4 { !self.seen.is_multiple_of(3) } else { self.seen == 1 || self.seen == 2 }
    }
}

/// What photons see of a glTF material, by way of what an MTL would say.
fn spec(m: &json::Material) -> Spec {
    let pbr = &m.pbr_metallic_roughness;
    let [r, g, b, alpha] = pbr.base_color_factor.unwrap_or([1.0; 4]);
    let textured = pbr.base_color_texture.is_some();
    let grey = if textured { TEXTURE_GREY } else { 1.0 };
    let base = [r, g, b].map(|v| v.clamp(0.0, 1.0) * grey);
    let metallic = pbr.metallic_factor.unwrap_or(1.0);
    let roughness = pbr.roughness_factor.unwrap_or(1.0);
    let strength = m.extensions.strength.as_ref().and_then(|s| s.emissive_strength).unwrap_or(1.0);
    let nits = m.emissive_factor.unwrap_or([0.0; 3]).map(|v| v * strength);
    let transmission = m.extensions.transmission.as_ref().map_or(0.0, |t| t.transmission_factor);
    let transmission = transmission.clamp(0.0, 1.0);
    let ior = m.extensions.ior.as_ref().and_then(|i| i.ior);
    let mut out = Spec { textured: m.emissive_texture.is_some(), ..Spec::default() };
    if nits.iter().any(|&v| v > 0.0) {
        // 3.9.4: candela per square metre.
        out.ke = Some(nits.map(|v| (v / LUMENS_PER_WATT).clamp(0.0, 1e20)));
    }
    if let Some(volume) = m.extensions.volume.as_ref().filter(|v| v.thickness_factor > 0.0)
        && transmission > 0.5
    {
        // Beer and Lambert: of white light, the colour is left after the distance.
        let color = volume.attenuation_color.unwrap_or([1.0; 3]);
        let distance = volume.attenuation_distance.filter(|d| *d > 0.0);
        let per_m = |c: f64| distance.map_or(0.0, |d| -libm::log(c.clamp(1e-6, 1.0)) / d);
        out.solid = true;
        out.tf = Some(base.map(|v| v * transmission));
        out.absorption = Some(color.map(|c| per_m(c).clamp(0.0, 1e6)));
        out.ni = ior;
    } else if transmission > 0.5 {
        out.glass = Some(true);
        out.tf = Some(base.map(|v| v * transmission));
        out.kd = Some(base.map(|v| v * (1.0 - transmission)));
        out.kd_final = true;
        out.ni = ior;
    } else if m.alpha_mode.as_deref() == Some("BLEND") && alpha < 1.0 {
        out.kd = Some(base);
        out.d = Some(alpha.max(0.0));
        out.ni = ior;
    } else {
        out.kd = Some(base);
        if roughness <= MATT {
            let metallic = metallic.clamp(0.0, 1.0);
            let plain = ior.filter(|&n| n > 1.0).map_or(DEFAULT_F0, f0_of);
            out.kd = Some(base.map(|v| v * (1.0 - metallic)));
            out.ks = Some(base.map(|v| plain + metallic * (v - plain)));
            out.pr = Some(roughness.clamp(0.0, 1.0));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strips_and_fans_as_the_specification_cuts_them() {
        let cut = |mode, n: u32| {
            let mut c = Cutter::new(mode);
            let t: Vec<[u32; 3]> = (0..n).filter_map(|v| c.next(v)).collect();
            (t, c.left_over())
        };
        assert_eq!(cut(4, 6), (vec![[0, 1, 2], [3, 4, 5]], false));
        assert_eq!(cut(4, 8), (vec![[0, 1, 2], [3, 4, 5]], true));
        assert_eq!(cut(5, 5), (vec![[0, 1, 2], [1, 3, 2], [2, 3, 4]], false));
        assert_eq!(cut(6, 5), (vec![[1, 2, 0], [2, 3, 0], [3, 4, 0]], false));
        assert_eq!(cut(6, 2), (vec![], true));
    }

    #[test]
    fn rooms_by_name_and_by_extras() {
        let node = |text: &str| serde_json::from_str::<json::Node>(text).unwrap();
        for (text, room, name) in [
            (r#"{"name": "Room: Kitchen"}"#, true, "Kitchen"),
            (r#"{"name": "IfcSpace/2hQ/Hall"}"#, true, "IfcSpace/2hQ/Hall"),
            (r#"{"name": "IfcSpaceHeater/1"}"#, false, "IfcSpaceHeater/1"),
            (r#"{"name": "Room"}"#, false, "Room"),
            (r#"{"name": "Room divider"}"#, false, "Room divider"),
            (r#"{"name": "x", "extras": {"room": true}}"#, true, "x"),
            (r#"{"name": "x", "extras": {"room": "Bath"}}"#, true, "Bath"),
            (r#"{"name": "IfcSpace/1", "extras": {"room": false}}"#, false, "IfcSpace/1"),
        ] {
            let n = node(text);
            let own = n.name.clone();
            let given = room_name(&n, own.as_deref(), own.clone().unwrap());
            assert_eq!(given, (room, name.to_string()), "{text}");
        }
    }
}

//! Puts a scene together: files, materials, placements, then one pass that measures what the stream
//! will hold.

use crate::{
    Doors, Frame, InputFile, LoadOptions, Material, Scene, SceneError, Up,
    file::{self, MaterialTable, Parsed, PointKind, SceneFile},
    frame::{Placements, local_matrix},
    gltf, hints,
    lamps::{self, Luminaires},
    lights, materials,
    mtl::{self, Spec},
    obj::{self, Mesh},
    shape::{Lookup, Part, Position},
    sky,
    stream::{Geometry, Glowing, MARK_EVERY, Scratch, Skipped, Use},
    texture::{self, Texture},
    views,
};
use enf_layout::{
    NONE,
    light::{LIGHT_POINT, LIGHT_POINT_LAMBERT, LightRecord, cone_steradians},
};
use glam::{DMat3, DMat4, DVec3, DVec4, Vec3};
use std::{
    collections::{BTreeMap, BTreeSet, HashSet},
    f64::consts::PI,
    path::{Path, PathBuf},
};
use toml::Spanned;

/// Beyond this many metres from zero, coordinates are stored relative to a scene origin.
const FAR: f64 = 4096.0;
/// No scene is larger, m: `f32` would have no millimetres left, by far.
const LARGEST: f64 = 1e6;
/// Larger ones are probably in other units, m.
const SUSPICIOUS: f64 = 5e3;
/// Name of what has no material.
const UNNAMED: &str = "unnamed";

/// Reads a scene: `.obj`, `.obj.zst`, `.gltf`, `.glb` or `.toml`.
///
/// Errors name the file, the line or object, and a remedy: files that are missing, damaged or of
/// another kind; faces that use vertices that are not there; unknown keys; a scene without any
/// triangle. What can be drawn all the same is a warning in [`Scene::warnings`]: missing materials,
/// triangles without area, vertices that are not finite.
pub fn load(path: &Path, options: &LoadOptions) -> Result<Scene, SceneError> {
    let kind = path.file_name().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    if let Some(units) = options.units
        && !file::usable_unit(units)
    {
        return Err(SceneError::whole(
            path,
            format!("units of {units} m"),
            "give --units m, cm, mm, ft, in or a number of metres",
        ));
    }
    if kind.ends_with(".toml") {
        from_toml(path, options)
    } else if is_gltf(path) {
        let mut loader = Loader::default();
        if options.up.is_some() {
            loader
                .warnings
                .push(format!("{}: --up is ignored: in glTF files y points up", path.display()));
        }
        let model = loader.model(path, options)?;
        let frame = Frame { units: options.units.unwrap_or(1.0), up: Up::Y, origin: [0.0; 3] };
        loader.place_model(model, &Listed::alone(), &Frame { units: 1.0, ..frame })?;
        loader.finish(path, stem(path), frame, options, None)
    } else if kind.ends_with(".obj") || kind.ends_with(".obj.zst") {
        let mut loader = Loader::default();
        let mesh = loader.mesh(path, options)?;
        loader.uses.push(Placing {
            mesh,
            name: stem(path),
            placements: Placements::identity(),
            whole: false,
            door: None,
            remap: BTreeMap::new(),
        });
        let frame = Frame {
            units: options.units.unwrap_or(1.0),
            up: options.up.unwrap_or_default(),
            origin: [0.0; 3],
        };
        loader.finish(path, stem(path), frame, options, None)
    } else {
        Err(SceneError::whole(
            path,
            "is no kind of scene that is read here",
            "give a .obj, a .obj.zst, a .gltf, a .glb or a scene file that ends in .toml",
        ))
    }
}

/// `duplex` of `data/duplex.obj.zst`.
fn stem(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let mut name = &*name;
    for end in [".zst", ".obj", ".gltf", ".glb", ".toml"] {
        let cut = name.len().saturating_sub(end.len());
        if name.get(cut..).is_some_and(|e| e.eq_ignore_ascii_case(end)) {
            name = &name[..cut];
        }
    }
    if file::name_problem(name).is_some() { "scene".into() } else { name.into() }
}

/// True for `.gltf` and `.glb`.
fn is_gltf(path: &Path) -> bool {
    path.extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("gltf") || e.eq_ignore_ascii_case("glb"))
}

/// A `[[mesh]]` before its materials are known.
struct Placing {
    mesh: usize,
    name: String,
    placements: Placements,
    whole: bool,
    door: Option<bool>,
    remap: BTreeMap<String, String>,
}

/// Files read so far.
#[derive(Default)]
struct Loader {
    meshes: Vec<Mesh>,
    /// MTL files of each mesh.
    mesh_libraries: Vec<Vec<PathBuf>>,
    libraries: BTreeMap<PathBuf, BTreeMap<String, Spec>>,
    by_path: BTreeMap<PathBuf, usize>,
    uses: Vec<Placing>,
    inputs: Vec<InputFile>,
    warnings: Vec<String>,
    /// glTF files, and the number of their first mesh.
    models: Vec<(gltf::Model, usize)>,
    models_by_path: BTreeMap<PathBuf, usize>,
    /// What glTF files hold beside meshes, in the coordinates of the scene's input.
    lights: Vec<gltf::Light>,
    cameras: Vec<gltf::Camera>,
    rooms: Vec<gltf::Room>,
}

/// What a `[[mesh]]` says about a glTF file.
struct Listed {
    /// Its name, if it is placed by `instances`.
    name: Option<String>,
    placements: Placements,
    door: Option<bool>,
    remap: BTreeMap<String, String>,
}

impl Listed {
    fn alone() -> Self {
        Self { name: None, placements: Placements::identity(), door: None, remap: BTreeMap::new() }
    }
}

impl Loader {
    /// Reads a glTF file, once.
    fn model(&mut self, path: &Path, options: &LoadOptions) -> Result<usize, SceneError> {
        let key = std::fs::canonicalize(path).unwrap_or_else(|_| path.into());
        if let Some(&model) = self.models_by_path.get(&key) {
            return Ok(model);
        }
        let mut model = gltf::read(path, options)?;
        let first = self.meshes.len();
        self.inputs.append(&mut model.inputs);
        self.warnings.append(&mut model.warnings);
        self.libraries.insert(path.into(), std::mem::take(&mut model.materials));
        for mut mesh in std::mem::take(&mut model.meshes) {
            self.warnings.append(&mut mesh.warnings);
            self.meshes.push(mesh);
            self.mesh_libraries.push(vec![path.into()]);
        }
        self.models.push((model, first));
        self.models_by_path.insert(key, self.models.len() - 1);
        Ok(self.models.len() - 1)
    }

    /// Places the nodes of a glTF file in the coordinates of the scene's input, which `frame` describes.
    fn place_model(
        &mut self,
        model: usize,
        listed: &Listed,
        frame: &Frame,
    ) -> Result<(), SceneError> {
        let (model, first) = &self.models[model];
        // From y up and metres to the input's.
        let turn = match frame.up {
            Up::Y => DMat3::IDENTITY,
            Up::Z => DMat3::from_cols(DVec3::X, DVec3::Z, DVec3::NEG_Y),
        };
        let into = DMat4::from_mat3(turn * (1.0 / frame.units));
        for node in &model.placed {
            let mut placements = Placements::default();
            for i in 0..listed.placements.len() {
                let m = local_matrix(listed.placements.get(i), frame.up);
                let rows: [DVec4; 4] = [
                    DVec4::from_slice(&m[0..4]),
                    DVec4::from_slice(&m[4..8]),
                    DVec4::from_slice(&m[8..12]),
                    DVec4::W,
                ];
                let place = DMat4::from_cols_array_2d(&rows.map(|r| r.to_array())).transpose();
                let world = (place * into * node.world).transpose();
                let mut numbers = [0.0; 12];
                for (row, out) in numbers.chunks_exact_mut(4).enumerate() {
                    out.copy_from_slice(&world.col(row).to_array());
                }
                placements.push(&numbers).map_err(|e| {
                    SceneError::whole(
                        &self.meshes[first + node.mesh].file,
                        format!("the node \"{}\" cannot be placed: {e}", node.name),
                        "correct the scales of the nodes, or --units",
                    )
                })?;
            }
            placements.shrink();
            let name = match &listed.name {
                Some(name) => format!("{name}/{}", node.name),
                None => node.name.clone(),
            };
            self.uses.push(Placing {
                mesh: first + node.mesh,
                door: listed.door.or(crate::doors::is_door(&name).then_some(true)),
                name,
                placements,
                whole: true,
                remap: listed.remap.clone(),
            });
        }
        if listed.name.is_some() {
            if !(model.lights.is_empty() && model.cameras.is_empty() && model.rooms.is_empty()) {
                self.warnings.push(format!(
                    "\"{}\": lights, cameras and rooms of a glTF file that is placed by \
                     instances are left out",
                    listed.name.as_deref().unwrap_or_default()
                ));
            }
            return Ok(());
        }
        let at = |p: DVec3| into.transform_point3(p);
        self.lights.extend(model.lights.iter().map(|l| gltf::Light {
            name: l.name.clone(),
            position: at(l.position),
            ahead: turn * l.ahead,
            cone: l.cone,
            flux: l.flux,
        }));
        self.cameras.extend(model.cameras.iter().map(|c| gltf::Camera {
            name: c.name.clone(),
            eye: at(c.eye),
            ahead: turn * c.ahead,
            up: turn * c.up,
            fov: c.fov,
        }));
        self.rooms.extend(model.rooms.iter().map(|r| gltf::Room {
            name: r.name.clone(),
            triangles: r.triangles.iter().map(|t| t.map(at)).collect(),
        }));
        Ok(())
    }

    /// Reads a mesh and its MTL files, once.
    fn mesh(&mut self, path: &Path, options: &LoadOptions) -> Result<usize, SceneError> {
        let key = std::fs::canonicalize(path).unwrap_or_else(|_| path.into());
        if let Some(&mesh) = self.by_path.get(&key) {
            return Ok(mesh);
        }
        let (mut mesh, input) = obj::read(path, options)?;
        self.inputs.push(input);
        self.warnings.append(&mut mesh.warnings);
        let mut libraries = Vec::new();
        for (library, line) in &mesh.libraries {
            let found = find_libraries(path, library);
            if found.is_empty() {
                if options.strict {
                    return Err(SceneError::line(
                        path,
                        *line,
                        format!("the material library \"{library}\" is missing"),
                        "put it beside the OBJ file, or do without --strict",
                    ));
                }
                self.warnings.push(format!(
                    "{}:{line}: the material library \"{library}\" is missing; put it beside the \
                     OBJ file",
                    path.display()
                ));
            }
            for at in found {
                if !self.libraries.contains_key(&at) {
                    let (specs, input) = mtl::read(&at)?;
                    self.inputs.push(input);
                    self.libraries.insert(at.clone(), specs);
                }
                libraries.push(at);
            }
        }
        self.meshes.push(mesh);
        self.mesh_libraries.push(libraries);
        self.by_path.insert(key, self.meshes.len() - 1);
        Ok(self.meshes.len() - 1)
    }

    /// What the MTL files of a mesh say about a material, or, for a name that the scene file brought
    /// in, any MTL file of the scene.
    fn spec(&self, mesh: usize, name: &str, anywhere: bool) -> Option<&Spec> {
        let own = self.mesh_libraries[mesh].iter().find_map(|l| self.libraries[l].get(name));
        own.or_else(|| {
            anywhere.then(|| self.libraries.values().find_map(|l| l.get(name))).flatten()
        })
    }
}

/// The files that an `mtllib` line means: the whole rest of the line, or its words; as given, or beside
/// the OBJ file.
pub(crate) fn find_libraries(obj: &Path, given: &str) -> Vec<PathBuf> {
    let folder = obj.parent().unwrap_or(Path::new(""));
    let find = |name: &str| {
        let name = name.replace('\\', "/");
        let base = name.rsplit('/').next().unwrap_or(&name);
        [folder.join(&name), folder.join(base)].into_iter().find(|p| p.is_file())
    };
    match find(given) {
        Some(one) => vec![one],
        None => given.split_whitespace().filter_map(find).collect(),
    }
}

fn from_toml(path: &Path, options: &LoadOptions) -> Result<Scene, SceneError> {
    let (parsed, input) = file::parse::<SceneFile>(path)?;
    let scene = &parsed.value;
    let mut loader = Loader { inputs: vec![input], ..Loader::default() };
    let name = match &scene.name {
        Some(name) => {
            if let Some(problem) = file::name_problem(name.get_ref()) {
                return Err(parsed.error(name, problem, "use letters and digits"));
            }
            name.get_ref().clone()
        }
        None => stem(path),
    };
    let frame = Frame {
        units: options.units.or(scene.units.map(|u| u.0)).unwrap_or(1.0),
        up: options.up.or(scene.up).unwrap_or_default(),
        origin: [0.0; 3],
    };
    let folder = path.parent().unwrap_or(Path::new(""));
    if scene.mesh.is_empty() {
        return Err(SceneError::whole(
            path,
            "no [[mesh]] in it",
            "name at least one model: [[mesh]] file = \"building.obj\"",
        ));
    }
    for at in &scene.mesh {
        let table = at.get_ref();
        let kind = table.file.to_ascii_lowercase();
        let file = folder.join(&table.file);
        if !(kind.ends_with(".obj") || kind.ends_with(".obj.zst") || is_gltf(&file)) {
            return Err(parsed.error(
                at,
                format!("mesh \"{}\" is no OBJ or glTF file", table.file),
                "give a .obj, .obj.zst, .gltf or .glb",
            ));
        }
        if !file.exists() {
            return Err(parsed.error(
                at,
                format!("mesh \"{}\" is missing", file.display()),
                "file names are relative to the scene file",
            ));
        }
        let from_file = match &table.instances_file {
            Some(_) if table.instances.is_some() => {
                return Err(parsed.error(
                    at,
                    "both \"instances\" and \"instances_file\"",
                    "give one of them",
                ));
            }
            Some(instances) => {
                let (placements, input) = file::read_instances(&folder.join(instances))?;
                loader.inputs.push(input);
                Some(placements)
            }
            None => None,
        };
        let whole = table.instances.is_some() || from_file.is_some();
        let mut placements =
            from_file.or_else(|| table.instances.clone()).unwrap_or_else(Placements::identity);
        placements.shrink();
        let name = table.name.clone().unwrap_or_else(|| stem(&file));
        let model = if is_gltf(&file) { Some(loader.model(&file, options)?) } else { None };
        let meshes = match model {
            Some(model) => {
                let (model, first) = &loader.models[model];
                let count = model.placed.iter().map(|p| p.mesh + 1).max().unwrap_or(0);
                *first..*first + count
            }
            None => {
                let mesh = loader.mesh(&file, options)?;
                mesh..mesh + 1
            }
        };
        for from in table.remapped() {
            let known = loader.meshes[meshes.clone()].iter().flat_map(|m| &m.materials);
            if !known.map(|m| m.as_deref().unwrap_or(UNNAMED)).any(|m| m == from) {
                loader.warnings.push(format!(
                    "{}: mesh \"{name}\" has no material \"{from}\" to replace",
                    path.display()
                ));
            }
        }
        if let Some(model) = model {
            let listed = Listed {
                name: whole.then_some(name),
                placements,
                door: table.door,
                remap: table.materials.clone(),
            };
            loader.place_model(model, &listed, &frame)?;
            continue;
        }
        let mesh = meshes.start;
        // A mesh that is placed as a whole may be a door by its own name.
        let door = table.door.or((whole && crate::doors::is_door(&name)).then_some(true));
        let remap = table.materials.clone();
        loader.uses.push(Placing { mesh, name, placements, whole, door, remap });
    }
    loader.finish(path, name, frame, options, Some(&parsed))
}

impl file::MeshTable {
    fn remapped(&self) -> impl Iterator<Item = &str> {
        self.materials.keys().map(String::as_str)
    }
}

/// Materials of the scene, in order of first use.
#[derive(Default)]
struct Table {
    materials: Vec<Material>,
    power: Vec<Option<[f64; 3]>>,
    /// Name to what was said and the id it got; one name may mean two things in two MTL files.
    ids: BTreeMap<String, Vec<(Spec, u32)>>,
    highlights: usize,
    textured: usize,
    textures: Vec<Texture>,
    /// Files of textures, for [`Scene::inputs`].
    pictures: Vec<InputFile>,
    /// Pictures that are not there, or of a kind that is not read.
    lost: BTreeSet<PathBuf>,
    scaled: Vec<String>,
}

impl Table {
    fn id(&mut self, name: &str, mut spec: Spec, library: &Path) -> Result<u32, SceneError> {
        let known = self.ids.entry(name.into()).or_default();
        if let Some((_, id)) = known.iter().find(|k| k.0 == spec) {
            return Ok(*id);
        }
        let said = spec.clone();
        self.lost.extend(spec.lost_map.take());
        let texture = self.texture(&mut spec)?;
        let known = self.ids.entry(name.into()).or_default();
        let id = self.materials.len() as u32;
        let name =
            if known.is_empty() { name.to_string() } else { format!("{name} ({})", stem(library)) };
        let mut mapped = materials::map(&spec);
        mapped.record.texture = texture;
        self.highlights += usize::from(mapped.highlight);
        self.textured += usize::from(spec.textured);
        if mapped.scaled {
            self.scaled.push(name.clone());
        }
        self.power.push(spec.power);
        self.materials.push(Material { name, record: mapped.record });
        known.push((said, id));
        Ok(id)
    }

    /// Number of a material's texture; it is forgotten if it cannot be read.
    fn texture(&mut self, spec: &mut Spec) -> Result<u32, SceneError> {
        let Some(map) = &spec.map_kd else { return Ok(NONE) };
        if let Some(at) = self.textures.iter().position(|t| t.is(map)) {
            return Ok(at as u32);
        }
        let Some(texture) = Texture::open(map)? else {
            self.lost.insert(map.source.path().into());
            spec.map_kd = None;
            return Ok(NONE);
        };
        if let Some(input) = texture::input_of(map)?
            && !self.pictures.iter().any(|p| p.path == input.path)
        {
            self.pictures.push(input);
        }
        self.textures.push(texture);
        Ok(self.textures.len() as u32 - 1)
    }

    fn emits(&self, id: u32) -> bool {
        let record = &self.materials[id as usize].record;
        self.power[id as usize].is_some() || record.emission.iter().any(|&v| v > 0.0)
    }
}

/// Some names, quoted, for a message.
fn some_names(names: &[String]) -> String {
    let shown: Vec<String> = names.iter().take(5).map(|n| format!("\"{n}\"")).collect();
    let rest = names.len().saturating_sub(5);
    let more = if rest > 0 { format!(" and {rest} more") } else { String::new() };
    format!("{}{more}", shown.join(", "))
}

impl Loader {
    /// Gives every use its scene materials.
    fn resolve(
        &mut self,
        path: &Path,
        parsed: Option<&Parsed<SceneFile>>,
        strict: bool,
    ) -> Result<(Table, Vec<Vec<u32>>), SceneError> {
        let mut overrides: BTreeMap<&str, &Spanned<MaterialTable>> = BTreeMap::new();
        for at in parsed.iter().flat_map(|p| &p.value.material) {
            if let (Some(p), true) = (parsed, overrides.insert(&at.get_ref().name, at).is_some()) {
                return Err(p.error(
                    at,
                    format!("material \"{}\" comes twice", at.get_ref().name),
                    "merge the two tables",
                ));
            }
        }
        let mut table = Table::default();
        let mut used: BTreeSet<&str> = BTreeSet::new();
        let mut per_use = Vec::with_capacity(self.uses.len());
        let mut missing: BTreeMap<usize, Vec<String>> = BTreeMap::new();
        let mut bare: BTreeSet<usize> = BTreeSet::new();
        for placing in &self.uses {
            let mesh = &self.meshes[placing.mesh];
            let mut ids = Vec::with_capacity(mesh.materials.len());
            for local in &mesh.materials {
                let local_name = local.as_deref().unwrap_or(UNNAMED);
                let remapped = placing.remap.get(local_name);
                let name = remapped.map_or(local_name, String::as_str);
                let said = self.spec(placing.mesh, name, remapped.is_some()).cloned();
                let spec = match overrides.get_key_value(name) {
                    Some((&key, at)) => {
                        used.insert(key);
                        let mut spec = said.unwrap_or_default();
                        if let (Some(p), Err(e)) = (parsed, at.get_ref().apply(&mut spec)) {
                            let what = format!("material \"{name}\": {e}");
                            return Err(p.error(*at, what, "correct the table"));
                        }
                        spec
                    }
                    None => said.unwrap_or_else(|| {
                        if local.is_none() && remapped.is_none() {
                            bare.insert(placing.mesh);
                        } else {
                            let names = missing.entry(placing.mesh).or_default();
                            if !names.iter().any(|n| n == name) {
                                names.push(name.into());
                            }
                        }
                        materials::default_spec()
                    }),
                };
                ids.push(table.id(name, spec, &mesh.file)?);
            }
            per_use.push(ids);
        }
        for (mesh, names) in missing {
            if strict {
                return Err(SceneError::whole(
                    &self.meshes[mesh].file,
                    format!("no definition of material {}", some_names(&names)),
                    "add it to the MTL file, or as a [[material]] to a scene file, or do without \
                     --strict",
                ));
            }
            self.warnings.push(format!(
                "{}: no definition of material {}; grey {} is used: add it to the MTL file, or as a \
                 [[material]] to a scene file",
                self.meshes[mesh].file.display(),
                some_names(&names),
                materials::DEFAULT_GREY
            ));
        }
        for mesh in bare {
            if strict {
                return Err(SceneError::whole(
                    &self.meshes[mesh].file,
                    "some faces have no material",
                    "give them one, or define \"unnamed\" as a [[material]] of a scene file, or do \
                     without --strict",
                ));
            }
            self.warnings.push(format!(
                "{}: some faces have no material; grey {} is used",
                self.meshes[mesh].file.display(),
                materials::DEFAULT_GREY
            ));
        }
        for (name, at) in &overrides {
            if !used.contains(name) {
                // Checked all the same.
                if let (Some(p), Err(e)) = (parsed, at.get_ref().apply(&mut Spec::default())) {
                    let what = format!("material \"{name}\": {e}");
                    return Err(p.error(*at, what, "correct the table"));
                }
                self.warnings
                    .push(format!("{}: no mesh uses the material \"{name}\"", path.display()));
            }
        }
        if table.highlights > 0 {
            self.warnings.push(format!(
                "{}: {} materials have a highlight (Ks) of no known width, which is not rendered: give \
                 Ns or Pr, or as a [[material]] a roughness",
                path.display(),
                table.highlights
            ));
        }
        if table.textured > 0 {
            self.warnings.push(format!(
                "{}: {} materials have maps other than of colour (map_Kd, baseColorTexture), which are not \
                 rendered",
                path.display(),
                table.textured
            ));
        }
        if let Some(first) = table.lost.first() {
            if strict {
                return Err(SceneError::whole(
                    first,
                    "the texture is missing, or neither PNG nor JPEG",
                    "put it beside the model, or do without --strict",
                ));
            }
            self.warnings.push(format!(
                "{}: {} textures are missing, or neither PNG nor JPEG; plain colours are used (first: {})",
                path.display(),
                table.lost.len(),
                first.display()
            ));
        }
        if !table.scaled.is_empty() {
            self.warnings.push(format!(
                "{}: reflectances below 0, or that sum to more than 1, were brought into range in \
                 material {}",
                path.display(),
                some_names(&table.scaled)
            ));
        }
        Ok((table, per_use))
    }

    fn finish(
        mut self,
        path: &Path,
        name: String,
        frame: Frame,
        options: &LoadOptions,
        parsed: Option<&Parsed<SceneFile>>,
    ) -> Result<Scene, SceneError> {
        let (mut table, per_use) = self.resolve(path, parsed, options.strict)?;
        self.split_components(&table, &per_use)?;

        let mut uses = Vec::with_capacity(self.uses.len());
        let mut objects = 0u64;
        for (placing, materials) in self.uses.into_iter().zip(per_use) {
            let used = Use {
                mesh: placing.mesh,
                name: placing.name,
                placements: placing.placements,
                whole: placing.whole,
                door: placing.door,
                first_object: objects as u32,
                materials,
                first: Vec::new(),
                marks: Vec::new(),
                glowing: Vec::new(),
            };
            objects += used.objects(&self.meshes) as u64;
            if objects >= u64::from(NONE) {
                return Err(SceneError::whole(path, "more than 2^32 objects", "merge objects"));
            }
            uses.push(used);
        }
        let mut geometry =
            Geometry { meshes: self.meshes, uses, frame, open: options.doors == Doors::Open };
        let mut warnings = self.warnings;
        geometry.frame.origin = scene_origin(&geometry, path)?;
        let frame = geometry.frame;
        if frame.origin != [0.0; 3] {
            warnings.push(format!(
                "{}: coordinates are large; {:?} m is subtracted from them",
                path.display(),
                frame.origin
            ));
        }
        let measured = measure(&mut geometry, path, |material| table.emits(material))?;
        let sky = parsed.map_or(Ok(None), sky::build)?;
        let mut luminaires = Luminaires::default();
        let folder = path.parent().unwrap_or(Path::new(""));
        let mut points =
            parsed.map_or(Ok(Vec::new()), |p| point_lights(p, folder, &frame, &mut luminaires))?;
        self.inputs.append(&mut luminaires.inputs);
        warnings.append(&mut luminaires.warnings);
        for light in self.lights {
            let position = frame.point(light.position.to_array());
            let record = match light.cone {
                Some(cone) => {
                    let axis = frame.direction(light.ahead.to_array()).unwrap_or([0.0, 0.0, -1.0]);
                    lamps::spot(position, axis, cone, light.flux)
                }
                None => lights::point(LIGHT_POINT, position, [0.0, 0.0, -1.0], light.flux),
            };
            points.push((light.name, record));
        }
        let mut views =
            parsed.map_or(Ok(Vec::new()), |p| views::build(p, &p.value.view, &frame))?;
        for camera in &self.cameras {
            views::add_camera(&mut views, camera, &frame);
        }
        let mut hints = Vec::new();
        if let Some(p) = parsed {
            let (rooms, mut files) = hints::build(p, folder, &frame, &mut warnings)?;
            hints = rooms;
            self.inputs.append(&mut files);
        }
        for room in &self.rooms {
            match hints::of_solid(&room.name, &room.triangles, &frame) {
                Some(hint) => hints.push(hint),
                None => warnings.push(format!(
                    "{}: the room \"{}\" has no volume: no hint",
                    path.display(),
                    room.name
                )),
            }
        }

        if let Some((object, corners)) = measured.first_flat {
            warnings.push(format!(
                "{}: {} triangles without area are left out (first in \"{}\" at {corners:?})",
                path.display(),
                measured.flat,
                object_name(&geometry, object)
            ));
        }
        if let Some((object, at)) = measured.first_not_finite {
            if options.strict {
                let what = format!(
                    "a face of \"{}\" uses vertex {}, which is not finite",
                    object_name(&geometry, object),
                    u64::from(at.vertex) + 1
                );
                let remedy = "correct the vertex, or do without --strict";
                return Err(match at.line {
                    Some(line) => SceneError::line(&at.file, line, what, remedy),
                    None => SceneError::whole(&at.file, what, remedy),
                });
            }
            warnings.push(format!(
                "{}: {} triangles with vertices that are not finite are left out (first in \"{}\")",
                path.display(),
                measured.not_finite,
                object_name(&geometry, object)
            ));
        }
        if measured.twice > 0 {
            warnings.push(format!(
                "{}: {} emitting faces are there twice; the second does not emit",
                path.display(),
                measured.twice
            ));
        }
        let dark = measured.areas.values().filter(|&&a| a == 0.0).count();
        if dark > 0 {
            warnings.push(format!("{}: {dark} lights without area are left out", path.display()));
        }
        let (mut lo, mut hi) = measured.bounds;
        for (_, p) in &points {
            for c in 0..3 {
                lo[c] = lo[c].min(p.position[c]);
                hi[c] = hi[c].max(p.position[c]);
            }
        }
        let delta = tolerance(lo, hi);
        for (_, light) in &mut points {
            luminaires.step_out(light, delta);
        }
        let diagonal = distance(lo, hi);
        check_size(diagonal, path)?;
        if !(0.1..=SUSPICIOUS).contains(&diagonal) {
            warnings.push(format!(
                "{}: the scene is {diagonal:.4} m across: are its units right? (--units)",
                path.display()
            ));
        }
        self.inputs.append(&mut table.pictures);
        let doors = door_objects(&geometry)?;
        let copies = lights::set_power(&mut table.materials, &table.power, &measured.areas, path)?;
        Ok(Scene {
            name,
            materials: table.materials,
            textures: table.textures,
            views,
            hints,
            sky,
            origin: frame.origin,
            bounds: (lo, hi),
            delta,
            warnings,
            inputs: self.inputs,
            geometry,
            count: measured.count,
            skipped: measured.flat + measured.not_finite,
            copies,
            points,
            profiles: luminaires.profiles,
            doors,
        })
    }

    /// Faces outside every object: those that emit become one object for each connected component, so
    /// that each is a light of its own.
    fn split_components(&mut self, table: &Table, per_use: &[Vec<u32>]) -> Result<(), SceneError> {
        for (m, mesh) in self.meshes.iter_mut().enumerate() {
            let Some(unnamed) = mesh.objects.iter().position(Option::is_none) else { continue };
            let emits = |local: u32| {
                self.uses.iter().zip(per_use).any(|(placing, ids)| {
                    placing.mesh == m && !placing.whole && table.emits(ids[local as usize])
                })
            };
            let emitting: Vec<u32> =
                (0..mesh.materials.len() as u32).filter(|&l| emits(l)).collect();
            for local in emitting {
                split(mesh, unnamed as u32, local)?;
            }
        }
        Ok(())
    }
}

/// Gives each connected component of a mesh's triangles of one object and material an object of its
/// own. Vertices at one place are one vertex.
fn split(mesh: &mut Mesh, object: u32, material: u32) -> Result<(), SceneError> {
    let Mesh { shape, objects, materials, .. } = mesh;
    let mut lookup = Lookup::<Position>::default();
    // The corners' places, triangle by triangle.
    let mut corners: Vec<u32> = Vec::new();
    for part in shape.parts() {
        let (part, triangles) = part?;
        if (part.object, part.material) == (object, material) {
            for t in triangles {
                corners.extend(lookup.triangle(shape, t)?);
            }
        }
    }
    let mut vertices = corners.clone();
    vertices.sort_unstable();
    vertices.dedup();
    let mut keyed: Vec<([u64; 3], u32)> = Vec::with_capacity(vertices.len());
    for &v in &vertices {
        // One zero only.
        keyed.push((lookup.vertex(shape, v, |p| p)?.map(|c| (c + 0.0).to_bits()), v));
    }
    keyed.sort_unstable();
    // Places: equal positions share a number.
    let mut place_of = vec![0u32; vertices.len()];
    let mut places = 0u32;
    for (i, (key, v)) in keyed.iter().enumerate() {
        if i > 0 && keyed[i - 1].0 != *key {
            places += 1;
        }
        place_of[vertices.partition_point(|w| w < v)] = places;
    }
    drop(keyed);
    for c in &mut corners {
        *c = place_of[vertices.partition_point(|w| w < c)];
    }
    drop((vertices, place_of));
    let mut parent: Vec<u32> = (0..=places).collect();
    fn root(parent: &mut [u32], mut i: u32) -> u32 {
        while parent[i as usize] != i {
            parent[i as usize] = parent[parent[i as usize] as usize];
            i = parent[i as usize];
        }
        i
    }
    for t in corners.chunks_exact(3) {
        for (p, q) in [(t[0], t[1]), (t[1], t[2])] {
            let (p, q) = (root(&mut parent, p), root(&mut parent, q));
            parent[p.max(q) as usize] = p.min(q);
        }
    }
    let label = materials[material as usize].clone();
    let label = label.as_deref().unwrap_or(UNNAMED).to_string();
    let mut component: BTreeMap<u32, u32> = BTreeMap::new();
    let mut next = 0;
    shape.rewrite_parts(|_, part, triangles, parts| {
        if (part.object, part.material) != (object, material) {
            parts.push(part);
            return Ok(());
        }
        for t in triangles {
            let at = root(&mut parent, corners[next]);
            next += 3;
            let number = component.len() as u32 + 1;
            let own = *component.entry(at).or_insert_with(|| {
                objects.push(Some(format!("{label} {number}")));
                objects.len() as u32 - 1
            });
            match parts.last_mut() {
                Some(Part { end, object, material, .. })
                    if (*object, *material, *end) == (own, part.material, t) =>
                {
                    *end = t + 1;
                }
                _ => parts.push(Part { end: t + 1, object: own, ..part }),
            }
        }
        Ok(())
    })
}

/// Objects recognised as doors, ascending.
fn door_objects(geometry: &Geometry) -> Result<Vec<u32>, SceneError> {
    let mut doors = Vec::new();
    for used in &geometry.uses {
        if used.door == Some(false) {
            continue;
        }
        for part in geometry.meshes[used.mesh].shape.parts() {
            let (part, _) = part?;
            if used.is_door(&part) {
                let instances = if used.whole { used.placements.len() } else { 1 };
                doors.extend((0..instances).map(|i| used.object(i, &part)));
                if used.whole {
                    break;
                }
            }
        }
    }
    doors.sort_unstable();
    doors.dedup();
    doors.shrink_to_fit();
    Ok(doors)
}

/// Name of an object: the OBJ file's, or the mesh's with the number of the instance.
pub(crate) fn object_name(geometry: &Geometry, object: u32) -> String {
    let at = geometry.uses.partition_point(|u| u.first_object <= object);
    let Some(used) = at.checked_sub(1).map(|i| &geometry.uses[i]) else {
        return format!("object {object}");
    };
    let own = object - used.first_object;
    if used.whole {
        return if used.placements.len() == 1 {
            used.name.clone()
        } else {
            format!("{}/{own}", used.name)
        };
    }
    match geometry.meshes[used.mesh].objects.get(own as usize) {
        Some(Some(name)) => name.clone(),
        Some(None) => used.name.clone(),
        None => format!("object {object}"),
    }
}

/// Zero, unless coordinates are large: then the bounds' centre in whole metres. A scene that is too
/// large for `f32` is refused.
fn scene_origin(geometry: &Geometry, path: &Path) -> Result<[f64; 3], SceneError> {
    let mut far = false;
    for used in &geometry.uses {
        let Some((lo, hi)) = geometry.meshes[used.mesh].bounds else { continue };
        for i in 0..used.placements.len() {
            let matrix = geometry.frame.matrix(used.placements.get(i));
            for corner in 0..8 {
                let pick = |c: usize| if corner >> c & 1 == 0 { lo[c] } else { hi[c] };
                let p = matrix.world(DVec3::new(pick(0), pick(1), pick(2)));
                far |= p.abs().max_element() > FAR;
            }
        }
        if far {
            break;
        }
    }
    if !far {
        return Ok([0.0; 3]);
    }
    // The boxes are larger than what is in them: now exactly.
    let (mut lo, mut hi) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    let mut lookup = Lookup::<DVec3>::default();
    for used in &geometry.uses {
        let shape = &geometry.meshes[used.mesh].shape;
        lookup.reset();
        for i in 0..used.placements.len() {
            let matrix = geometry.frame.matrix(used.placements.get(i));
            for t in 0..shape.triangles() as u32 {
                for v in lookup.triangle(shape, t)? {
                    let p = matrix.world(lookup.vertex(shape, v, DVec3::from_array)?);
                    if p.abs().max_element() <= f64::from(f32::MAX) {
                        (lo, hi) = (lo.min(p), hi.max(p));
                    }
                }
            }
        }
    }
    if lo.x > hi.x || lo.abs().max(hi.abs()).max_element() <= FAR {
        return Ok([0.0; 3]);
    }
    check_size((hi - lo).length(), path)?;
    Ok(((lo + hi) * 0.5).to_array().map(|v| v.round() + 0.0))
}

/// Refuses what is far too large to be a building or a city.
fn check_size(diagonal: f64, path: &Path) -> Result<(), SceneError> {
    if diagonal > LARGEST {
        return Err(SceneError::whole(
            path,
            format!("the scene is {diagonal:.3e} m across"),
            "give the units of the file (--units mm, or units = \"mm\" in a scene file), or remove \
             what lies far away",
        ));
    }
    Ok(())
}

/// What one pass over the stream finds.
struct Measured {
    count: u64,
    bounds: ([f32; 3], [f32; 3]),
    flat: u64,
    first_flat: Option<(u32, [f32; 3])>,
    not_finite: u64,
    first_not_finite: Option<(u32, BadVertex)>,
    /// Emitting faces that an object's light already has.
    twice: u64,
    /// Area of each (object, emitting material), m².
    areas: BTreeMap<(u32, u32), f64>,
}

/// A vertex that is not finite, and where it stands.
struct BadVertex {
    file: PathBuf,
    vertex: u32,
    line: Option<usize>,
}

/// The vertex of a triangle that is not finite: the first that the reader noted.
fn bad_vertex(mesh: &Mesh, vertices: [u32; 3]) -> BadVertex {
    let line_of = |v: u32| {
        let at = mesh.not_finite.binary_search_by_key(&v, |n| n.0).ok()?;
        Some(mesh.not_finite[at].1)
    };
    let known = vertices.into_iter().find_map(|v| Some((v, line_of(v)?)));
    BadVertex {
        file: mesh.file.clone(),
        vertex: known.map_or(vertices[0], |k| k.0),
        line: known.map(|k| k.1),
    }
}

fn measure(
    geometry: &mut Geometry,
    path: &Path,
    emits: impl Fn(u32) -> bool,
) -> Result<Measured, SceneError> {
    let mut m = Measured {
        count: 0,
        bounds: Default::default(),
        flat: 0,
        first_flat: None,
        not_finite: 0,
        first_not_finite: None,
        twice: 0,
        areas: BTreeMap::new(),
    };
    let (mut lo, mut hi) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    let mut noted = Vec::with_capacity(geometry.uses.len());
    let mut scratch = Scratch::default();
    let mut faces: HashSet<(u32, u32, u128)> = HashSet::new();
    for used in &geometry.uses {
        let mesh = &geometry.meshes[used.mesh];
        let spooled = geometry.is_spooled(used);
        let marks_each =
            (mesh.shape.triangles().saturating_sub(1) / u64::from(MARK_EVERY)) as usize;
        let mut first = Vec::with_capacity(used.placements.len());
        let mut marks = Vec::with_capacity(used.placements.len() * marks_each);
        let mut glowing = Vec::new();
        for i in 0..used.placements.len() {
            first.push(m.count as u32);
            faces.clear();
            let mut placed = geometry.place(used, i, &mut scratch);
            for run in geometry.runs(used, i) {
                let run = run?;
                let mut area = 0.0;
                let emitting = emits(run.material);
                if emitting && spooled {
                    glowing.push(Glowing {
                        instance: i as u32,
                        object: run.object,
                        material: run.material,
                        begin: run.triangles.start,
                        end: run.triangles.end,
                        index: m.count as u32,
                    });
                }
                for t in run.triangles {
                    while t / MARK_EVERY > (marks.len() - i * marks_each) as u32 {
                        marks.push(m.count as u32);
                    }
                    match placed.corners(t)? {
                        Ok(corners) => {
                            m.count += 1;
                            for p in corners {
                                lo = lo.min(Vec3::from_array(p));
                                hi = hi.max(Vec3::from_array(p));
                            }
                            if emitting {
                                let key = lights::face_key(&corners);
                                if faces.insert((run.object, run.material, key)) {
                                    area += lights::area(&corners);
                                } else {
                                    m.twice += 1;
                                }
                            }
                        }
                        Err(Skipped::Flat) => {
                            m.flat += 1;
                            if m.first_flat.is_none() {
                                m.first_flat = Some((run.object, placed.vertices(t)?.1));
                            }
                        }
                        Err(Skipped::NotFinite) => {
                            m.not_finite += 1;
                            if m.first_not_finite.is_none() {
                                let bad = bad_vertex(mesh, placed.vertices(t)?.0);
                                m.first_not_finite = Some((run.object, bad));
                            }
                        }
                    }
                }
                if emitting {
                    *m.areas.entry((run.object, run.material)).or_insert(0.0) += area;
                }
            }
            marks.resize((i + 1) * marks_each, m.count as u32);
            if m.count >= u64::from(NONE) {
                return Err(SceneError::whole(
                    path,
                    "more than 4,294,967,294 triangles",
                    "split the scene",
                ));
            }
        }
        noted.push((first, marks, glowing));
    }
    m.bounds = (lo.to_array(), hi.to_array());
    for (used, (first, marks, glowing)) in geometry.uses.iter_mut().zip(noted) {
        used.first = first;
        used.marks = marks;
        used.glowing = glowing;
        used.glowing.shrink_to_fit();
    }
    if m.count == 0 {
        let what = match m.flat + m.not_finite {
            0 => "no triangle in it".into(),
            bad => format!("none of its {bad} triangles has an area"),
        };
        return Err(SceneError::whole(
            path,
            what,
            "give a model with faces (f v1 v2 v3), and check --doors and --units",
        ));
    }
    Ok(m)
}

fn distance(lo: [f32; 3], hi: [f32; 3]) -> f64 {
    let d: [f64; 3] = std::array::from_fn(|c| f64::from(hi[c]) - f64::from(lo[c]));
    DVec3::from_array(d).length()
}

/// 2^-19 of the next power of two at or above the largest coordinate and the diagonal.
fn tolerance(lo: [f32; 3], hi: [f32; 3]) -> f32 {
    let largest = lo.iter().chain(&hi).map(|v| f64::from(v.abs())).fold(distance(lo, hi), f64::max);
    let mut m = 1.0f64;
    while m < largest {
        m *= 2.0;
    }
    while m * 0.5 >= largest && m > 1e-12 {
        m *= 0.5;
    }
    (m / f64::from(1u32 << 19)) as f32
}

/// The `[[light]]` tables of a scene file.
fn point_lights(
    parsed: &Parsed<SceneFile>,
    folder: &Path,
    frame: &Frame,
    luminaires: &mut Luminaires,
) -> Result<Vec<(String, LightRecord)>, SceneError> {
    let mut out = Vec::with_capacity(parsed.value.light.len());
    for (i, at) in parsed.value.light.iter().enumerate() {
        let table = at.get_ref();
        let name = table.name.clone().unwrap_or_else(|| format!("light-{}", i + 1));
        let fail = |what: &str, remedy: &str| {
            parsed.error(at, format!("light \"{name}\": {what}"), remedy)
        };
        let wrong = |what: String| fail(&what, "correct the table");
        table.check().map_err(wrong)?;
        let position = frame.point(table.position);
        if position.iter().any(|v| !v.is_finite()) {
            return Err(fail("its position is not finite", "give finite coordinates"));
        }
        let down = match frame.up {
            Up::Z => [0.0, 0.0, -1.0],
            Up::Y => [0.0, -1.0, 0.0],
        };
        let towards = |t: [f64; 3]| std::array::from_fn(|c| t[c] - table.position[c]);
        let ahead = table.target.map(towards).or(table.direction).unwrap_or(down);
        let Some(axis) = frame.direction(ahead) else {
            return Err(match table.target {
                Some(_) => fail("its target is where it is", "give another \"target\""),
                None => fail("its direction has no length", "give three numbers, not all zero"),
            });
        };
        let point = |kind, per_candela| -> Result<LightRecord, SceneError> {
            let flux = table.flux(per_candela).map_err(wrong)?;
            Ok(lights::point(kind, position, axis, flux))
        };
        let record = match table.kind {
            PointKind::Point => point(LIGHT_POINT, 4.0 * PI)?,
            PointKind::LambertPoint => point(LIGHT_POINT_LAMBERT, PI)?,
            PointKind::Spot => {
                let outer = table.outer.unwrap_or(45.0);
                let cone = lamps::cone(table.inner.unwrap_or(0.0), outer).map_err(wrong)?;
                let flux = table.flux(cone_steradians(cone)).map_err(wrong)?;
                lamps::spot(position, axis, cone, flux)
            }
            PointKind::Ies => {
                let Some(file) = &table.file else {
                    return Err(fail("it has no \"file\"", "name an IES file"));
                };
                let ahead = DVec3::from_array(axis.map(f64::from)).normalize();
                let aim = lamps::Aim { down: ahead, turn: table.turn.unwrap_or(0.0) };
                let luminaire = luminaires.get(&folder.join(file))?;
                let lumens = luminaire.lumens * luminaire.photometry.tilt_factor(aim.tilt());
                let flux = table.luminaire_flux(lumens).map_err(wrong)?;
                lamps::measured(luminaire, position, aim, flux)
            }
        };
        if record.flux_w.iter().all(|&w| w == 0.0) {
            continue;
        }
        out.push((name.clone(), record));
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tolerance_follows_powers_of_two() {
        // A 64 m scene: 64 * 2^-19 = 1.22e-4 m.
        assert_eq!(tolerance([0.0; 3], [64.0, 0.0, 0.0]), 64.0 / 524288.0);
        assert_eq!(tolerance([0.0; 3], [64.5, 0.0, 0.0]), 128.0 / 524288.0);
        // Far from zero the coordinates decide.
        assert_eq!(tolerance([-1000.0, 0.0, 0.0], [-999.0, 1.0, 0.0]), 1024.0 / 524288.0);
        assert_eq!(tolerance([0.0; 3], [0.2, 0.0, 0.0]), 0.25 / 524288.0);
    }

    #[test]
    fn stems() {
        for (path, name) in [
            ("a/duplex.obj.zst", "duplex"),
            ("x.OBJ", "x"),
            ("scene.toml", "scene"),
            ("a.b.obj", "a.b"),
            (".obj", "scene"),
        ] {
            assert_eq!(stem(Path::new(path)), name);
        }
    }
}

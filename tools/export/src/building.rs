//! A scene as the tracer would see it, from a scene file, a model or a store: whole, in memory.

use std::path::Path;

use enf_geometry::TileMesh;
use enf_layout::NONE;
use enf_layout::light::{EmitterRecord, LIGHT_SKY, LIGHT_SUN, LightRecord};
use enf_layout::material::MaterialRecord;
use enf_layout::profile::{Profile, ProfileRecord};
use enf_layout::sections;
use enf_layout::segment::ExtentKind;
use enf_layout::texture::{SECTION_COORDINATES, SECTION_TEXTURED};
use enf_scene::{LoadOptions, Projection, SceneError, View};
use enf_stage::tables::Tables;
use enf_stage::{Failure, Result};
use enf_store::{MemoryBudget, StoreDir, StoreError};
use enf_transport::texture::linear;

/// What a store's tables and one of its tiles may take in memory.
const BUDGET: u64 = 8 << 30;

/// A triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Triangle {
    /// Global index.
    pub index: u32,
    /// Corners, m, counter-clockwise from the front.
    pub corners: [[f32; 3]; 3],
    /// Material id.
    pub material: u32,
    /// Places of the corners on the material's picture: right from its left border in widths, down from its upper border
    /// in heights.
    pub places: Option<[[f32; 2]; 3]>,
}

/// A picture that a reflectance is multiplied by.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Texels in a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Linear Rec.709, rows from the top.
    pub texels: Vec<[f32; 3]>,
    /// `TEXTURE_*` bits of [`enf_layout::texture`].
    pub flags: u32,
    /// Mean of the texels.
    pub mean: [f32; 3],
    /// From texture coordinates (u, v, 1) to places.
    pub place: [[f32; 3]; 2],
}

/// A light, and its emitting triangles or its measured intensities.
#[derive(Clone, Debug, PartialEq)]
pub struct Light {
    /// Name.
    pub name: String,
    /// What the photons know of it.
    pub record: LightRecord,
    /// Emitting triangles of an area light.
    pub emitters: Vec<EmitterRecord>,
    /// Measured intensities, and their values.
    pub profile: Option<(ProfileRecord, Vec<f32>)>,
}

impl Light {
    /// Its measured intensities, if it has some.
    pub fn profile(&self) -> Option<Profile<'_>> {
        let (record, values) = self.profile.as_ref()?;
        Profile::new(&ProfileRecord { first_value: 0, ..*record }, values).ok()
    }
}

/// What triangles of a group share: material, light or [`NONE`], and whether they lie on a picture.
pub(crate) type Key = (u32, u32, bool);

/// A whole building.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Building {
    /// Name.
    pub name: String,
    /// Names and records, by material id.
    pub materials: Vec<(String, MaterialRecord)>,
    /// By texture id.
    pub pictures: Vec<Picture>,
    /// Ascending by index.
    pub triangles: Vec<Triangle>,
    /// Area lights and points; daylight is not among them.
    pub lights: Vec<Light>,
    /// There is a sky over it.
    pub daylight: bool,
    /// Cameras.
    pub views: Vec<View>,
    /// What the reader of the scene had to say.
    pub warnings: Vec<String>,
}

impl Building {
    /// Reads a store (a folder), or a scene file or model.
    ///
    /// # Errors
    /// Exit 4 for what is missing or bad, naming the place.
    pub fn read(path: &Path, options: &LoadOptions) -> Result<Self> {
        let mut building =
            if path.is_dir() { Self::of_store(path)? } else { Self::of_scene(path, options)? };
        building.place();
        Ok(building)
    }

    fn of_scene(path: &Path, options: &LoadOptions) -> Result<Self> {
        let bad = |e: SceneError| Failure::input(e.to_string());
        let scene = enf_scene::load(path, options).map_err(bad)?;
        let mut pictures = Vec::with_capacity(scene.textures.len());
        for texture in &scene.textures {
            let read = texture.decode(0).map_err(bad)?;
            pictures.push(Picture {
                width: read.width,
                height: read.height,
                texels: read.texels.iter().map(|t| t.map(linear)).collect(),
                flags: texture.flags,
                mean: read.mean,
                place: texture.place,
            });
        }
        let mut triangles = Vec::new();
        scene
            .for_each_triangle(|t| {
                let (index, corners, material) = (t.index, t.corners, t.material);
                triangles.push(Triangle { index, corners, material, places: t.coordinates });
            })
            .map_err(bad)?;
        let all = scene.lights().map_err(bad)?;
        let mut lights = Vec::with_capacity(all.records.len());
        for (record, name) in all.records.iter().zip(&all.names) {
            let first = record.first_emitter as usize;
            let emitters = all.emitters[first..first + record.emitter_count as usize].to_vec();
            let profile = all
                .profiles
                .records
                .get(record.profile as usize)
                .map(|p| (*p, all.profiles.values[p.first_value as usize..].to_vec()));
            lights.push(Light { name: name.clone(), record: *record, emitters, profile });
        }
        Ok(Self {
            name: scene.name.clone(),
            materials: scene.materials.iter().map(|m| (m.name.clone(), m.record)).collect(),
            pictures,
            triangles,
            lights,
            daylight: scene.sky.is_some(),
            views: scene.views.clone(),
            warnings: scene.warnings.clone(),
        })
    }

    fn of_store(path: &Path) -> Result<Self> {
        let store = StoreDir::open(path)?;
        let budget = MemoryBudget::new(BUDGET);
        let tables = Tables::open(&store, &budget)?;
        let mut triangles: Vec<Triangle> = Vec::new();
        for tile in 0..tables.tiles().len() as u32 {
            let partition = &tables.partition;
            let extent = partition.single(ExtentKind::Geometry, tile)?;
            let blob = partition.read(extent, &budget, "mesh of a tile")?;
            let mesh = TileMesh::from_blob(&blob).map_err(StoreError::from)?;
            let placed = match partition.find(ExtentKind::Coordinates, tile) {
                [] => None,
                _ => Some(partition.read(
                    partition.single(ExtentKind::Coordinates, tile)?,
                    &budget,
                    "texture coordinates of a tile",
                )?),
            };
            let (textured, places): (&[u32], &[[[f32; 2]; 3]]) = match &placed {
                None => (&[], &[]),
                Some(blob) => (
                    sections::section(blob, SECTION_TEXTURED).map_err(StoreError::from)?,
                    sections::section(blob, SECTION_COORDINATES).map_err(StoreError::from)?,
                ),
            };
            for i in 0..mesh.len() {
                let index = mesh.global[i as usize];
                triangles.push(Triangle {
                    index,
                    corners: mesh.corners(i).map(|c| c.to_array()),
                    material: mesh.materials[i as usize],
                    places: textured
                        .binary_search(&index)
                        .ok()
                        .and_then(|at| places.get(at).copied()),
                });
            }
        }
        // Neighbouring tiles hold copies.
        triangles.sort_by_key(|t| t.index);
        triangles.dedup_by_key(|t| t.index);
        if let Some(bad) =
            triangles.iter().find(|t| t.material as usize >= tables.materials().len())
        {
            return Err(Failure::input(format!(
                "triangle {} has material {}, and the store has {}",
                bad.index,
                bad.material,
                tables.materials().len()
            )));
        }
        let name_of = |names: &[String], kind: &str, i: usize| {
            names.get(i).cloned().unwrap_or_else(|| format!("{kind} {i}"))
        };
        let names = &tables.names;
        let lights = tables.lights().iter().enumerate().map(|(i, record)| {
            let profile = tables.profiles().get(record.profile as usize).map(|p| {
                (*p, tables.profile_values().get(p.first_value as usize..).unwrap_or(&[]).to_vec())
            });
            Light {
                name: name_of(&names.lights, "light", i),
                record: *record,
                emitters: tables.emitters_of(record).to_vec(),
                profile,
            }
        });
        Ok(Self {
            name: names.scene.clone(),
            materials: (tables.materials().iter().enumerate())
                .map(|(i, m)| (name_of(&names.materials, "material", i), *m))
                .collect(),
            pictures: (tables.textures().iter())
                .map(|t| {
                    let first = t.first_texel as usize;
                    let size = t.width as usize * t.height as usize;
                    let texels = &tables.texels()[first..first + size];
                    Picture {
                        width: t.width,
                        height: t.height,
                        texels: texels.iter().map(|t| t.map(linear)).collect(),
                        flags: t.flags,
                        mean: t.mean,
                        place: t.place,
                    }
                })
                .collect(),
            triangles,
            lights: lights.filter(|l| ![LIGHT_SKY, LIGHT_SUN].contains(&l.record.kind)).collect(),
            daylight: tables.sky.is_some(),
            views: (tables.views().iter().enumerate())
                .map(|(i, record)| View {
                    name: name_of(&names.views, "view", i),
                    projection: (names.projections.get(i))
                        .and_then(|p| Projection::of(p))
                        .unwrap_or_default(),
                    record: *record,
                })
                .collect(),
            warnings: Vec::new(),
        })
    }

    /// From texture coordinates to places on pictures.
    fn place(&mut self) {
        for triangle in &mut self.triangles {
            let texture = self.materials[triangle.material as usize].1.texture;
            let picture = self.pictures.get(texture as usize).filter(|_| texture != NONE);
            triangle.places = match (picture, triangle.places) {
                (Some(picture), Some(corners)) => {
                    Some(corners.map(|[u, v]| picture.place.map(|[a, b, c]| a * u + b * v + c)))
                }
                _ => None,
            };
        }
    }

    /// The triangles that emit, with the light of each, ascending by index.
    pub(crate) fn emitting(&self) -> Vec<(u32, u32)> {
        let mut all: Vec<(u32, u32)> = (self.lights.iter().enumerate())
            .flat_map(|(i, l)| l.emitters.iter().map(move |e| (e.triangle, i as u32)))
            .collect();
        all.sort_unstable();
        all
    }

    /// Triangles in groups that share a key, ascending.
    pub(crate) fn groups(&self) -> Vec<(Key, Vec<&Triangle>)> {
        let emitting = self.emitting();
        let mut keyed: Vec<(Key, &Triangle)> = (self.triangles.iter())
            .map(|t| {
                let at = emitting.binary_search_by_key(&t.index, |e| e.0);
                let light = at.map_or(NONE, |at| emitting[at].1);
                ((t.material, light, t.places.is_some()), t)
            })
            .collect();
        keyed.sort_by_key(|(key, t)| (*key, t.index));
        keyed
            .chunk_by(|a, b| a.0 == b.0)
            .map(|group| (group[0].0, group.iter().map(|g| g.1).collect()))
            .collect()
    }
}

/// Buildings that tests of several formats write.
#[cfg(test)]
pub(crate) mod samples {
    use enf_layout::light::LIGHT_AREA;

    use super::*;

    /// A lamp of one triangle that is there twice: listed, and once more, dark.
    pub(crate) fn lamp() -> Building {
        let corners = [[0.0, 0.0, 2.0], [0.0, 1.0, 2.0], [1.0, 0.0, 2.0]];
        let triangle = Triangle { index: 0, corners, material: 0, places: None };
        let record = MaterialRecord { emission: [5.0, 4.0, 3.0], ..MaterialRecord::BLACK };
        let emitter = EmitterRecord { corners, triangle: 0, cumulative: 1.0, reserved: 0 };
        let light = Light {
            name: "lamp".into(),
            record: LightRecord { kind: LIGHT_AREA, material: 0, ..LightRecord::DARK },
            emitters: vec![emitter],
            profile: None,
        };
        Building {
            materials: vec![("lamp".into(), record)],
            triangles: vec![triangle, Triangle { index: 1, ..triangle }],
            lights: vec![light],
            ..Building::default()
        }
    }
}

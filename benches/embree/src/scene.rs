//! A scene to measure: triangles, lights, and the rooms that it is made of.

use std::collections::HashMap;
use std::fs;
use std::io;
use std::ops::Range;
use std::path::{Path, PathBuf};

use glam::Vec3;

/// Vertices in m, one more in memory than there are: Embree reads 16 bytes at each.
#[derive(Clone, Debug)]
pub struct Vertices(Vec<[f32; 3]>);

impl Vertices {
    /// Takes a list over.
    pub fn new(mut list: Vec<[f32; 3]>) -> Self {
        list.push([0.0; 3]);
        Self(list)
    }

    /// The vertices, without the last one that is none.
    pub fn list(&self) -> &[[f32; 3]] {
        &self.0[..self.0.len().saturating_sub(1)]
    }
}

/// A parallelogram that sends light to the side of `u x v`; not part of the mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Light {
    /// A corner, m.
    pub corner: Vec3,
    /// One edge, m.
    pub u: Vec3,
    /// The other edge, m.
    pub v: Vec3,
}

impl Light {
    /// Unit normal of the side that shines.
    pub fn normal(&self) -> Vec3 {
        self.u.cross(self.v).normalize()
    }

    /// The point at `s`, `t` in `[0, 1]`, m.
    pub fn at(&self, s: f64, t: f64) -> Vec3 {
        self.corner + s as f32 * self.u + t as f32 * self.v
    }
}

/// A room of a scene: a box whose surface no triangle crosses.
#[derive(Clone, Debug)]
pub struct Room {
    /// Lower corner of its box, m.
    pub min: Vec3,
    /// Upper corner of its box, m.
    pub max: Vec3,
    /// Its triangles.
    pub triangles: Range<u32>,
}

/// A mesh with its lights and rooms.
#[derive(Clone, Debug)]
pub struct Scene {
    /// What to call it.
    pub name: String,
    /// Vertices, m, z up.
    pub vertices: Vertices,
    /// Corners of each triangle; in range.
    pub triangles: Vec<[u32; 3]>,
    /// At least one.
    pub lights: Vec<Light>,
    /// The rooms, or one room of everything. Every triangle is in one of them.
    pub rooms: Vec<Room>,
}

/// What can be wrong with a scene's files.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    /// A file cannot be read or written.
    #[error("{path}: {error}")]
    File {
        /// The file.
        path: PathBuf,
        /// Why.
        error: io::Error,
    },
    /// A file's content makes no sense.
    #[error("{path}: {what}")]
    Content {
        /// The file.
        path: PathBuf,
        /// Where, what is wrong, and what would be right.
        what: String,
    },
}

impl Scene {
    /// Welds equal vertices (bit for bit, in order of first use) of a soup and drops triangles that have no
    /// three corners. `rooms` are ranges of the soup.
    pub fn weld(
        name: &str,
        soup: &[[[f32; 3]; 3]],
        lights: Vec<Light>,
        mut rooms: Vec<Room>,
    ) -> Self {
        let mut index: HashMap<[u32; 3], u32> = HashMap::new();
        let mut vertices = Vec::new();
        let mut triangles = Vec::with_capacity(soup.len());
        // How many triangles are left of the soup up to each; only ends of rooms are asked for.
        let mut ends = rooms.iter().map(|r| r.triangles.end).collect::<Vec<_>>();
        let mut room = 0;
        for (i, corners) in soup.iter().enumerate() {
            while room < ends.len() && ends[room] == i as u32 {
                ends[room] = triangles.len() as u32;
                room += 1;
            }
            let triangle = corners.map(|p| {
                // -0 is 0.
                let p = p.map(|x| x + 0.0);
                *index.entry(p.map(f32::to_bits)).or_insert_with(|| {
                    vertices.push(p);
                    vertices.len() as u32 - 1
                })
            });
            let [a, b, c] = triangle;
            if a != b && b != c && a != c {
                triangles.push(triangle);
            }
        }
        ends[room..].fill(triangles.len() as u32);
        let mut start = 0;
        for (room, end) in rooms.iter_mut().zip(ends) {
            room.triangles = start..end;
            start = end;
        }
        Self { name: name.to_owned(), vertices: Vertices::new(vertices), triangles, lights, rooms }
    }

    /// Reads `PREFIX.vtx` (`f32` x, y, z for each vertex), `PREFIX.idx` (three `u32` for each triangle), both
    /// little-endian, and, where it is there, `PREFIX.light` (text, a light on each line: corner and two
    /// edges, nine numbers; more are ignored). Without one, a light of 0.6 x 0.6 m hangs 2 cm below the
    /// middle of the scene's upper bound.
    pub fn read(prefix: &Path) -> Result<Self, SceneError> {
        let vertex_path = with_ending(prefix, "vtx");
        let vertices: Vec<[f32; 3]> = triples(&vertex_path, f32::from_le_bytes)?;
        let content = |path: &Path, what: String| SceneError::Content { path: path.into(), what };
        if let Some(i) = vertices.iter().position(|v| !v.iter().all(|x| x.is_finite())) {
            return Err(content(&vertex_path, format!("vertex {i} is not finite")));
        }
        let path = with_ending(prefix, "idx");
        let triangles: Vec<[u32; 3]> = triples(&path, u32::from_le_bytes)?;
        if triangles.is_empty() || triangles.len() >= u32::MAX as usize {
            return Err(content(&path, format!("{} triangles: 1 to 2^32 - 2", triangles.len())));
        }
        let count = vertices.len();
        if let Some(i) = triangles.iter().position(|t| t.iter().any(|&v| v as usize >= count)) {
            let what = format!("triangle {i} has corners {:?} of {count} vertices", triangles[i]);
            return Err(content(&path, what));
        }
        let (min, max) = bounds(&vertices);
        let path = with_ending(prefix, "light");
        let lights = match fs::read_to_string(&path) {
            Ok(text) => read_lights(&text).map_err(|what| content(&path, what))?,
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                let corner = Vec3::new(
                    0.5 * (min.x + max.x) - 0.3,
                    0.5 * (min.y + max.y) - 0.3,
                    max.z - 0.02,
                );
                vec![Light { corner, u: 0.6 * Vec3::Y, v: 0.6 * Vec3::X }]
            }
            Err(error) => return Err(SceneError::File { path, error }),
        };
        let name = prefix.file_name().unwrap_or(prefix.as_os_str()).to_string_lossy().into_owned();
        let rooms = vec![Room { min, max, triangles: 0..triangles.len() as u32 }];
        Ok(Self { name, vertices: Vertices::new(vertices), triangles, lights, rooms })
    }

    /// Writes the files that [`Scene::read`] reads into a folder.
    pub fn write(&self, folder: &Path) -> Result<(), SceneError> {
        let prefix = folder.join(&self.name);
        let write = |ending: &str, bytes: Vec<u8>| {
            let path = with_ending(&prefix, ending);
            fs::write(&path, bytes).map_err(|error| SceneError::File { path, error })
        };
        fs::create_dir_all(folder)
            .map_err(|error| SceneError::File { path: folder.into(), error })?;
        write(
            "vtx",
            self.vertices.list().iter().flatten().flat_map(|x| x.to_le_bytes()).collect(),
        )?;
        write("idx", self.triangles.iter().flatten().flat_map(|x| x.to_le_bytes()).collect())?;
        let mut text = String::new();
        for light in &self.lights {
            let numbers: Vec<String> = [light.corner, light.u, light.v]
                .iter()
                .flat_map(|v| v.to_array())
                .map(|x| x.to_string())
                .collect();
            text += &(numbers.join(" ") + "\n");
        }
        write("light", text.into_bytes())
    }

    /// The box of all vertices, m.
    pub fn bounds(&self) -> (Vec3, Vec3) {
        bounds(self.vertices.list())
    }

    /// The project's tolerance, m: 2^-19 of the power of two not below any coordinate or the diagonal.
    pub fn delta(&self) -> f32 {
        let (min, max) = self.bounds();
        let diagonal = (max - min).as_dvec3().length();
        let largest = f64::from(min.abs().max_element().max(max.abs().max_element())).max(diagonal);
        let mut power = 1.0f64;
        while power < largest {
            power *= 2.0;
        }
        while power * 0.5 >= largest && power > 1e-12 {
            power *= 0.5;
        }
        (power / f64::from(1u32 << 19)) as f32
    }

    /// Unit normal of a triangle; zero where it has no area.
    pub fn normal(&self, triangle: u32) -> Vec3 {
        let vertices = self.vertices.list();
        let [a, b, c] = self.triangles[triangle as usize]
            .map(|v| Vec3::from_array(vertices[v as usize]).as_dvec3());
        (b - a).cross(c - a).normalize_or_zero().as_vec3()
    }
}

fn bounds(vertices: &[[f32; 3]]) -> (Vec3, Vec3) {
    vertices
        .iter()
        .map(|&v| Vec3::from_array(v))
        .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(min, max), p| (min.min(p), max.max(p)))
}

fn with_ending(prefix: &Path, ending: &str) -> PathBuf {
    let mut path = prefix.as_os_str().to_owned();
    path.push(".");
    path.push(ending);
    path.into()
}

fn triples<T: Copy>(path: &Path, number: fn([u8; 4]) -> T) -> Result<Vec<[T; 3]>, SceneError> {
    let bytes = fs::read(path).map_err(|error| SceneError::File { path: path.into(), error })?;
    if bytes.len() % 12 != 0 {
        let what = format!("{} bytes are no multiple of 12: cut short?", bytes.len());
        return Err(SceneError::Content { path: path.into(), what });
    }
    let word = |b: &[u8]| number([b[0], b[1], b[2], b[3]]);
    Ok(bytes.chunks_exact(12).map(|b| [word(b), word(&b[4..]), word(&b[8..])]).collect())
}

fn read_lights(text: &str) -> Result<Vec<Light>, String> {
    let mut lights = Vec::new();
    for (i, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
        let numbers: Vec<f32> = line
            .split_whitespace()
            .take(9)
            .map(|word| word.parse().map_err(|_| format!("line {}: {word:?} is no number", i + 1)))
            .collect::<Result<_, _>>()?;
        let [a, b, c, d, e, f, g, h, j] = numbers[..] else {
            return Err(format!("line {}: {} numbers, not 9", i + 1, numbers.len()));
        };
        let light =
            Light { corner: Vec3::new(a, b, c), u: Vec3::new(d, e, f), v: Vec3::new(g, h, j) };
        let area = light.u.cross(light.v).length();
        if !(light.corner.is_finite() && area.is_finite() && area > 0.0) {
            return Err(format!("line {}: the light has no area", i + 1));
        }
        lights.push(light);
    }
    if lights.is_empty() { Err("no light in it".to_owned()) } else { Ok(lights) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder(name: &str) -> PathBuf {
        let path = std::env::temp_dir().join(format!("bench-embree-{name}-{}", std::process::id()));
        fs::create_dir_all(&path).unwrap();
        path
    }

    fn tent() -> Scene {
        let soup = [
            [[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 3.0, 0.0]],
            [[4.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 3.0, 0.0]],
            [[-0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 0.0, 2.0]],
        ];
        let light = Light { corner: Vec3::new(1.0, 1.0, 1.5), u: Vec3::Y, v: Vec3::X };
        let room = |triangles| Room { min: Vec3::ZERO, max: Vec3::splat(4.0), triangles };
        Scene::weld("tent", &soup, vec![light], vec![room(0..2), room(2..3)])
    }

    #[test]
    fn welding_drops_what_has_no_area_and_keeps_rooms_apart() {
        let scene = tent();
        assert_eq!(scene.triangles, [[0, 1, 2], [0, 1, 3]]);
        assert_eq!(scene.vertices.list().len(), 4);
        assert_eq!(
            (scene.rooms[0].triangles.clone(), scene.rooms[1].triangles.clone()),
            (0..1, 1..2)
        );
        assert_eq!(scene.normal(0), Vec3::Z);
        // The diagonal is sqrt(29) m, below 8 = 2^3.
        assert_eq!(scene.delta(), 8.0 / (1 << 19) as f32);
    }

    #[test]
    fn files_come_back_as_they_went() {
        let scene = tent();
        let folder = folder("files");
        scene.write(&folder).unwrap();
        let read = Scene::read(&folder.join("tent")).unwrap();
        assert_eq!(read.vertices.list(), scene.vertices.list());
        assert_eq!(read.triangles, scene.triangles);
        assert_eq!(read.lights, scene.lights);
        fs::remove_file(folder.join("tent.light")).unwrap();
        let hung = Scene::read(&folder.join("tent")).unwrap().lights[0];
        assert_eq!(hung.normal(), Vec3::NEG_Z);
        assert_eq!(hung.at(0.5, 0.5), Vec3::new(2.0, 1.5, 1.98));
        fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn bad_files_are_named() {
        let folder = folder("bad");
        let scene = tent();
        let error = |prefix: &Path| Scene::read(prefix).unwrap_err().to_string();
        assert!(error(&folder.join("none")).contains("none.vtx"));
        scene.write(&folder).unwrap();
        let prefix = folder.join("tent");
        fs::write(folder.join("tent.light"), "1 2 3 0 0 0 1 0 0").unwrap();
        assert!(error(&prefix).contains("line 1: the light has no area"));
        fs::write(folder.join("tent.light"), "\n1 2 x").unwrap();
        assert!(error(&prefix).contains("line 2: \"x\" is no number"));
        fs::write(folder.join("tent.idx"), [9u8; 12]).unwrap();
        assert!(error(&prefix).contains("triangle 0 has corners"));
        fs::write(folder.join("tent.idx"), [0u8; 11]).unwrap();
        assert!(error(&prefix).contains("11 bytes"));
        fs::write(folder.join("tent.vtx"), f32::NAN.to_le_bytes().repeat(3)).unwrap();
        assert!(error(&prefix).contains("vertex 0 is not finite"));
        fs::remove_dir_all(&folder).unwrap();
    }
}

//! What the triangles of a scene are made of, and the scene as others read it: OBJ with a scene file, and Radiance.

use std::fmt::Write as _;
use std::fs;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use crate::scene::{Scene, SceneError};

/// A Lambertian material.
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    /// As `usemtl` says it.
    pub name: String,
    /// Reflectance, red, green and blue.
    pub diffuse: [f32; 3],
}

/// Materials, and which one each triangle has.
#[derive(Clone, Debug, PartialEq)]
pub struct Surfaces {
    /// At least one.
    pub materials: Vec<Material>,
    /// For each triangle; in range.
    pub of: Vec<u8>,
}

/// Reflectance where no file says any.
const GREY: f32 = 0.5;
/// Radiance of every light, W/m2/sr.
pub const RADIANCE: f32 = 30.0;

fn beside(prefix: &Path, ending: &str) -> PathBuf {
    let mut path = prefix.as_os_str().to_owned();
    path.push(ending);
    path.into()
}

impl Surfaces {
    /// All alike.
    pub fn grey(scene: &Scene) -> Self {
        let materials = vec![Material { name: "grey".into(), diffuse: [GREY; 3] }];
        Self { materials, of: vec![0; scene.triangles.len()] }
    }

    /// Reads `PREFIX.mat`, a byte for each triangle, and `PREFIX_mats.rad`, Radiance's `plastic` for each number, in order.
    /// Without them everything is grey.
    pub fn read(prefix: &Path, scene: &Scene) -> Result<Self, SceneError> {
        let path = beside(prefix, ".mat");
        let of = match fs::read(&path) {
            Ok(of) => of,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Self::grey(scene)),
            Err(error) => return Err(SceneError::File { path, error }),
        };
        let list = beside(prefix, "_mats.rad");
        let text = fs::read_to_string(&list)
            .map_err(|error| SceneError::File { path: list.clone(), error })?;
        let materials = plastics(&text).map_err(|what| SceneError::Content { path: list, what })?;
        if of.len() != scene.triangles.len() || of.iter().any(|&m| m as usize >= materials.len()) {
            let what = format!(
                "{} bytes for {} triangles of {} materials",
                of.len(),
                scene.triangles.len(),
                materials.len()
            );
            return Err(SceneError::Content { path, what });
        }
        Ok(Self { materials, of })
    }

    /// Writes `NAME.obj`, `NAME.mtl` and `NAME.toml` for us, and `NAME.rad` for Radiance.
    pub fn write(&self, scene: &Scene, folder: &Path) -> Result<(), SceneError> {
        let path = |ending: &str| folder.join(format!("{}.{ending}", scene.name));
        let file = |ending: &str, write: &dyn Fn(&mut dyn Write) -> io::Result<()>| {
            let path = path(ending);
            let made = fs::create_dir_all(folder)
                .and_then(|()| fs::File::create(&path))
                .map(BufWriter::new)
                .and_then(|mut out| write(&mut out).and_then(|()| out.flush()));
            made.map_err(|error| SceneError::File { path, error })
        };
        file("obj", &|out| self.obj(scene, out))?;
        let mut mtl = format!("newmtl lamp\nKd 0 0 0\nKe {RADIANCE} {RADIANCE} {RADIANCE}\n");
        for Material { name, diffuse: [r, g, b] } in &self.materials {
            let _ = write!(mtl, "newmtl {name}\nKd {r} {g} {b}\n");
        }
        file("mtl", &|out| out.write_all(mtl.as_bytes()))?;
        file("toml", &|out| writeln!(out, "[[mesh]]\nfile = \"{}.obj\"", scene.name))?;
        file("rad", &|out| self.rad(scene, out))
    }

    fn obj(&self, scene: &Scene, out: &mut dyn Write) -> io::Result<()> {
        writeln!(out, "mtllib {}.mtl\no rooms", scene.name)?;
        for [x, y, z] in scene.vertices.list() {
            writeln!(out, "v {x} {y} {z}")?;
        }
        let mut last = None;
        for (&material, corners) in self.of.iter().zip(&scene.triangles) {
            if last.replace(material) != Some(material) {
                writeln!(out, "usemtl {}", self.materials[material as usize].name)?;
            }
            let [a, b, c] = corners.map(|v| v + 1);
            writeln!(out, "f {a} {b} {c}")?;
        }
        for (i, light) in scene.lights.iter().enumerate() {
            writeln!(out, "o lamp{i}\nusemtl lamp")?;
            for (s, t) in [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)] {
                let p = light.at(s, t);
                writeln!(out, "v {} {} {}", p.x, p.y, p.z)?;
            }
            writeln!(out, "f -4 -3 -2 -1")?;
        }
        Ok(())
    }

    fn rad(&self, scene: &Scene, out: &mut dyn Write) -> io::Result<()> {
        for Material { name, diffuse: [r, g, b] } in &self.materials {
            writeln!(out, "void plastic {name}\n0\n0\n5 {r} {g} {b} 0 0")?;
        }
        writeln!(out, "void light lamp\n0\n0\n3 {RADIANCE} {RADIANCE} {RADIANCE}")?;
        for (i, light) in scene.lights.iter().enumerate() {
            write!(out, "lamp polygon lamp{i}\n0\n0\n12")?;
            for (s, t) in [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)] {
                let p = light.at(s, t);
                write!(out, " {} {} {}", p.x, p.y, p.z)?;
            }
            writeln!(out)?;
        }
        let vertices = scene.vertices.list();
        for (i, (&material, corners)) in self.of.iter().zip(&scene.triangles).enumerate() {
            write!(out, "{} polygon t{i}\n0\n0\n9", self.materials[material as usize].name)?;
            for [x, y, z] in corners.map(|v| vertices[v as usize]) {
                write!(out, " {x} {y} {z}")?;
            }
            writeln!(out)?;
        }
        Ok(())
    }
}

/// `void plastic NAME 0 0 5 R G B specularity roughness`, one after the other.
fn plastics(text: &str) -> Result<Vec<Material>, String> {
    let words: Vec<&str> = text.split_whitespace().collect();
    let mut materials = Vec::new();
    for (i, words) in words.chunks(11).enumerate() {
        let ["void", "plastic", name, "0", "0", "5", r, g, b, "0", "0"] = words else {
            return Err(format!("material {i} is no plastic without gloss: {}", words.join(" ")));
        };
        let mut diffuse = [0.0; 3];
        for (value, word) in diffuse.iter_mut().zip([r, g, b]) {
            *value = word.parse().map_err(|_| format!("material {i}: {word:?} is no number"))?;
        }
        materials.push(Material { name: (*name).to_owned(), diffuse });
    }
    if materials.is_empty() { Err("no material in it".to_owned()) } else { Ok(materials) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plastics_are_read() {
        let text = "void plastic wall\n0\n0\n5 0.55 0.53 0.5 0 0\nvoid plastic floor\n0\n0\n5 0.5 0.42 0.35 0 0\n";
        let found = plastics(text).unwrap();
        assert_eq!((found.len(), found[1].name.as_str()), (2, "floor"));
        assert_eq!(found[0].diffuse, [0.55, 0.53, 0.5]);
        for bad in
            ["", "void metal a 0 0 5 1 1 1 0 0", "void plastic a 0 0 5 1 1 x 0 0", "void plastic"]
        {
            assert!(plastics(bad).is_err(), "{bad}");
        }
    }
}

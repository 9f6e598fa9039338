//! The architect's spaces and doors: `NAME.truth.json`, and the solids of the spaces where there are any.

use glam::{DVec2, DVec3};
use serde_json::Value;
use std::collections::BTreeMap;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Words in the names of spaces that are no rooms.
const OUTDOORS: [&str; 7] = ["roof", "yard", "dock", "terrace", "balcony", "patio", "site"];

/// Why the truth cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum TruthError {
    /// The file cannot be opened or unpacked.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// The file is not what it should be.
    #[error("{path}: {what}")]
    Content {
        /// The file.
        path: PathBuf,
        /// Where in it, and what is wrong.
        what: String,
    },
}

/// What a space covers in plan.
#[derive(Clone, Debug, PartialEq)]
pub enum Shape {
    /// The triangles of its solid, m.
    Solid(Vec<[DVec3; 3]>),
    /// Nothing but its box is known; the floor area is the author's.
    Box,
}

/// A space that the architect drew.
#[derive(Clone, Debug, PartialEq)]
pub struct Space {
    /// Name, and what it is used for.
    pub name: String,
    /// Lower corner of its box, m.
    pub min: DVec3,
    /// Upper corner.
    pub max: DVec3,
    /// Floor area, m2.
    pub area: f64,
    /// Its shape.
    pub shape: Shape,
    /// Not the inside of a building (a roof, the site), for the reason given.
    pub outdoors: bool,
}

impl Space {
    /// Height at which its plan is compared, m: 1 m above its floor, or half way up if it is low.
    pub fn level(&self) -> f64 {
        self.min.z + (0.5 * (self.max.z - self.min.z)).clamp(0.0, 1.0)
    }

    /// The outline of its solid at a height, as segments; the four sides of the box without a solid.
    pub fn outline(&self, z: f64) -> Vec<[DVec2; 2]> {
        let Shape::Solid(triangles) = &self.shape else {
            let (a, b) = (self.min.truncate(), self.max.truncate());
            let corners = [a, DVec2::new(b.x, a.y), b, DVec2::new(a.x, b.y)];
            return (0..4).map(|i| [corners[i], corners[(i + 1) % 4]]).collect();
        };
        let mut out = Vec::new();
        for t in triangles {
            let mut ends = [DVec2::ZERO; 2];
            let mut count = 0;
            for k in 0..3 {
                let (a, b) = (t[k], t[(k + 1) % 3]);
                // Half open: a corner at this height belongs to what is above.
                if (a.z < z) != (b.z < z) && count < 2 {
                    ends[count] = (a + (b - a) * ((z - a.z) / (b.z - a.z))).truncate();
                    count += 1;
                }
            }
            if count == 2 {
                out.push(ends);
            }
        }
        out
    }
}

impl Space {
    /// Its footprint: the longest ring of its outline, m. Empty if there is none.
    pub fn footprint(&self) -> Vec<DVec2> {
        let mut left = self.outline(self.level());
        let mut longest: (f64, Vec<DVec2>) = (0.0, Vec::new());
        while let Some([first, mut end]) = left.pop() {
            let mut ring = vec![first, end];
            let mut length = (end - first).length();
            // Sections of two triangles meet on their common edge, up to rounding.
            while let Some((k, far)) = next(&left, end) {
                left.swap_remove(k);
                length += (far - end).length();
                end = far;
                ring.push(far);
            }
            if (end - first).length() < MEET {
                ring.pop();
            }
            if length > longest.0 && ring.len() > 2 {
                longest = (length, ring);
            }
        }
        longest.1
    }
}

/// Segments of an outline this close to each other meet, m.
const MEET: f64 = 1e-4;

/// The segment that goes on from a point: its index and its far end.
fn next(left: &[[DVec2; 2]], from: DVec2) -> Option<(usize, DVec2)> {
    left.iter().enumerate().find_map(|(k, &[a, b])| {
        if (a - from).length() < MEET {
            Some((k, b))
        } else if (b - from).length() < MEET {
            Some((k, a))
        } else {
            None
        }
    })
}

/// A door, a window or another opening that the architect drew.
#[derive(Clone, Debug, PartialEq)]
pub struct Door {
    /// Name.
    pub name: String,
    /// Middle of the opening, m.
    pub centre: DVec3,
    /// Unit normal of the opening.
    pub normal: DVec3,
    /// Thickness of the wall around it, m.
    pub thickness: f64,
    /// Width of the opening, m.
    pub width: f64,
    /// It is a door rather than a window or a hole.
    pub door: bool,
    /// It leads outside.
    pub exterior: bool,
    /// The spaces that it connects, in no order; `None` is outside or no space.
    pub spaces: [Option<usize>; 2],
}

/// All that is known about a building.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Truth {
    /// Name of the model.
    pub model: String,
    /// Its spaces.
    pub spaces: Vec<Space>,
    /// Its doors, windows and holes that connect something with something else.
    pub doors: Vec<Door>,
}

fn read(path: &Path) -> Result<Vec<u8>, TruthError> {
    let io = |source| TruthError::Io { path: path.into(), source };
    let file = std::fs::File::open(path).map_err(io)?;
    let mut bytes = Vec::new();
    if path.extension().is_some_and(|e| e == "zst") {
        zstd::stream::read::Decoder::new(file)
            .and_then(|mut d| d.read_to_end(&mut bytes))
            .map_err(io)?;
    } else {
        std::io::BufReader::new(file).read_to_end(&mut bytes).map_err(io)?;
    }
    Ok(bytes)
}

/// Reads the truth file and, if given, the solids of the spaces (`.obj` or `.obj.zst`, one object per space
/// named as in the truth file).
///
/// # Errors
/// [`TruthError`] naming the file and the place.
pub fn load(path: &Path, solids: Option<&Path>) -> Result<Truth, TruthError> {
    let solids = match solids {
        Some(p) => {
            parse_solids(&read(p)?).map_err(|what| TruthError::Content { path: p.into(), what })?
        }
        None => BTreeMap::new(),
    };
    parse(&read(path)?, &solids).map_err(|what| TruthError::Content { path: path.into(), what })
}

fn vector(value: &Value) -> Option<DVec3> {
    let list = value.as_array().filter(|l| l.len() == 3)?;
    let v = DVec3::new(list[0].as_f64()?, list[1].as_f64()?, list[2].as_f64()?);
    v.is_finite().then_some(v)
}

fn text(value: &Value) -> String {
    value.as_str().unwrap_or("").trim().to_string()
}

/// Parses the text of a truth file.
///
/// # Errors
/// A sentence that names the place.
pub fn parse(bytes: &[u8], solids: &BTreeMap<String, Vec<[DVec3; 3]>>) -> Result<Truth, String> {
    let root: Value = serde_json::from_slice(bytes).map_err(|e| e.to_string())?;
    let mut truth = Truth { model: text(&root["model"]), ..Truth::default() };
    let mut by_guid: BTreeMap<String, usize> = BTreeMap::new();
    let list = root["spaces"].as_array().ok_or("no list of spaces: nothing to compare with")?;
    for (i, s) in list.iter().enumerate() {
        let corners = if s["bbox"].is_array() { &s["bbox"] } else { &s["cobie_bbox"] };
        let (Some(min), Some(max)) = (vector(&corners[0]), vector(&corners[1])) else {
            continue; // A site has no box.
        };
        let guid = text(&s["guid"]);
        let name = [text(&s["name"]), text(&s["long_name"])];
        let area =
            ["floor_area_mesh_m2", "cobie_net_area_m2", "cobie_gross_area_m2", "ifc_NetFloorArea"]
                .iter()
                .find_map(|k| s[k].as_f64())
                .ok_or_else(|| format!("spaces[{i}] ({}): no floor area", name[0]))?;
        if min.cmpgt(max).any() || !(area.is_finite() && area >= 0.0) {
            return Err(format!("spaces[{i}] ({}): its box or its area is impossible", name[0]));
        }
        let outdoors = s["interior_or_exterior"] == "EXTERNAL"
            || name.iter().any(|n| {
                n.to_ascii_lowercase()
                    .split(|c: char| !c.is_alphabetic())
                    .any(|w| OUTDOORS.contains(&w))
            });
        let shape = solids.get(&text(&s["object"])).map_or(Shape::Box, |t| Shape::Solid(t.clone()));
        by_guid.insert(guid, truth.spaces.len());
        truth.spaces.push(Space {
            name: name.join(" ").trim().into(),
            min,
            max,
            area,
            shape,
            outdoors,
        });
    }
    for (i, p) in root["portals"].as_array().map_or(&[][..], Vec::as_slice).iter().enumerate() {
        let connects = text(&p["connects"]);
        if connects != "interior" && connects != "exterior" {
            continue;
        }
        let (Some(centre), Some(normal)) =
            (vector(&p["portal"]["centre"]), vector(&p["portal"]["normal"]))
        else {
            return Err(format!("portals[{i}]: no centre or no normal"));
        };
        let author = &p["spaces_by_cobie"];
        let sides = if author.is_array() { author } else { &p["spaces_by_geometry"] };
        let side = |k: usize| sides[k].as_str().and_then(|g| by_guid.get(g)).copied();
        let mut spaces = [side(0), side(1)];
        let outdoors = |s: Option<usize>| s.is_some_and(|s| truth.spaces[s].outdoors);
        let exterior = connects == "exterior" || spaces.iter().any(|&s| outdoors(s));
        for s in &mut spaces {
            *s = s.filter(|_| !outdoors(*s));
        }
        if spaces[0] == spaces[1] || normal.length() < 0.5 {
            continue; // Within one space.
        }
        truth.doors.push(Door {
            name: text(if p["cobie_name"].is_string() { &p["cobie_name"] } else { &p["name"] }),
            centre,
            normal: normal.normalize(),
            thickness: p["wall_thickness"].as_f64().unwrap_or(0.0).clamp(0.0, 2.0),
            width: p["portal"]["width"].as_f64().unwrap_or(0.0),
            door: p["kind"] == "door",
            exterior,
            spaces,
        });
    }
    Ok(truth)
}

/// The triangles of each object of an OBJ, by its name.
///
/// # Errors
/// A sentence that names the line.
pub fn parse_solids(bytes: &[u8]) -> Result<BTreeMap<String, Vec<[DVec3; 3]>>, String> {
    let text = std::str::from_utf8(bytes).map_err(|e| e.to_string())?;
    let mut corners: Vec<DVec3> = Vec::new();
    let mut solids: BTreeMap<String, Vec<[DVec3; 3]>> = BTreeMap::new();
    let mut name = String::new();
    for (i, line) in text.lines().enumerate() {
        let bad = |what: &str| format!("line {}: {what}", i + 1);
        let mut words = line.split_whitespace();
        match words.next() {
            Some("o") => {
                name = words.collect::<Vec<_>>().join(" ");
            }
            Some("v") => {
                let mut c = words.map(str::parse::<f64>);
                let mut next = || c.next().and_then(Result::ok).filter(|x| x.is_finite());
                let (Some(x), Some(y), Some(z)) = (next(), next(), next()) else {
                    return Err(bad("a vertex has three finite numbers"));
                };
                corners.push(DVec3::new(x, y, z));
            }
            Some("f") => {
                let mut face = Vec::new();
                for word in words {
                    let index = word.split('/').next().and_then(|w| w.parse::<usize>().ok());
                    let corner = index.and_then(|n| corners.get(n.checked_sub(1)?));
                    face.push(
                        *corner.ok_or_else(|| bad("a face names a vertex that is not there"))?,
                    );
                }
                let solid = solids.entry(name.clone()).or_default();
                for k in 2..face.len() {
                    solid.push([face[0], face[k - 1], face[k]]);
                }
            }
            _ => {}
        }
    }
    Ok(solids)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_truth_file_is_read_and_bad_ones_name_the_place() {
        let good = br#"{"model": "m", "spaces": [
            {"guid": "a", "name": "1", "long_name": "Hall", "bbox": [[0,0,0],[4,5,3]], "floor_area_mesh_m2": 20},
            {"guid": "b", "name": "2", "long_name": "Roof", "cobie_bbox": [[4,0,0],[9,5,3]], "cobie_net_area_m2": 25},
            {"guid": "c", "name": "Site", "cobie_bbox": null},
            {"guid": "d", "name": "4", "long_name": "Office", "bbox": [[0,5,0],[4,9,3]], "floor_area_mesh_m2": 16}],
          "portals": [{"kind": "door", "name": "D", "connects": "interior", "wall_thickness": 0.2,
            "portal": {"centre": [4,2,1], "normal": [1,0,0], "width": 0.9}, "spaces_by_geometry": ["a", "b"]},
           {"connects": "none"}, {"kind": "window", "connects": "exterior",
            "portal": {"centre": [0,2,1], "normal": [1,0,0]}, "spaces_by_geometry": ["a", null]},
           {"kind": "door", "connects": "interior",
            "portal": {"centre": [2,5,1], "normal": [0,1,0]}, "spaces_by_geometry": ["d", "a"]}]}"#;
        let truth = parse(good, &BTreeMap::new()).unwrap();
        assert_eq!(truth.spaces.len(), 3);
        assert_eq!(truth.spaces[0].name, "1 Hall");
        assert!(truth.spaces[1].outdoors && !truth.spaces[0].outdoors);
        assert_eq!(truth.doors.len(), 3);
        // A door onto a roof leads outside.
        assert_eq!(truth.doors[0].spaces, [Some(0), None]);
        assert!(truth.doors[0].exterior && truth.doors[0].door);
        assert_eq!(truth.doors[1].spaces, [Some(0), None]);
        assert!(truth.doors[1].exterior && !truth.doors[1].door);
        assert_eq!(truth.doors[2].spaces, [Some(2), Some(0)]);
        assert!(!truth.doors[2].exterior);
        let bad = br#"{"spaces": [{"guid": "a", "name": "1", "bbox": [[0,0,0],[4,5,3]]}]}"#;
        assert!(parse(bad, &BTreeMap::new()).unwrap_err().contains("spaces[0]"));
        assert!(parse(b"{}", &BTreeMap::new()).is_err());
        assert!(parse(b"{", &BTreeMap::new()).is_err());
    }

    #[test]
    fn the_outline_of_a_solid_is_its_section() {
        let obj = b"o IfcSpace/g/1\nv 0 0 0\nv 2 0 0\nv 0 3 0\nv 0 0 2\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n";
        let solids = parse_solids(obj).unwrap();
        let space = Space {
            name: String::new(),
            min: DVec3::ZERO,
            max: DVec3::new(2.0, 3.0, 2.0),
            area: 3.0,
            shape: Shape::Solid(solids["IfcSpace/g/1"].clone()),
            outdoors: false,
        };
        assert!((space.level() - 1.0).abs() < 1e-12);
        let outline = space.outline(1.0);
        assert_eq!(outline.len(), 3);
        assert_eq!(space.footprint().len(), 3);
        // Half way up the section is half as long.
        let around: f64 = outline.iter().map(|s| (s[1] - s[0]).length()).sum();
        assert!((around - 0.5 * (2.0 + 3.0 + 13.0_f64.sqrt())).abs() < 1e-12);
        assert!(parse_solids(b"v 0 0\n").unwrap_err().contains("line 1"));
        assert!(parse_solids(b"v 0 0 0\nf 1 2 3\n").unwrap_err().contains("line 2"));
    }
}

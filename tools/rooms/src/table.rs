//! Prints a comparison.

use crate::found::Place;
use crate::score::{Between, LEAST_AREA, Score, Share};
use crate::truth::Truth;
use serde_json::{Value, json};
use std::fmt::Write;

fn place(p: Place) -> String {
    match p {
        Place::Room(r) => r.to_string(),
        Place::Outside => "outside".into(),
        Place::Solid => "wall".into(),
    }
}

fn share(s: Share) -> String {
    format!("{} of {} ({:.1} %)", s.good, s.all, s.percent())
}

/// What became of a space, in words.
fn verdict(score: &Score, index: usize) -> String {
    let s = &score.spaces[index];
    let pieces = || {
        let list: Vec<String> =
            s.rooms.iter().map(|r| format!("{} ({:.0} %)", r.0, 100.0 * r.1)).collect();
        list.join(", ")
    };
    if s.room.is_some() {
        if s.rooms.len() > 1 {
            format!("matched, in pieces: {}", pieces())
        } else {
            "matched".into()
        }
    } else if s.outside > 0.5 {
        format!("{:.0} % of it is outside", 100.0 * s.outside)
    } else if score.merged.iter().any(|m| m.spaces.contains(&index)) {
        let open = if score.open(index) { ", no wall between" } else { "" };
        format!("part of a larger room{open}: {}", pieces())
    } else if s.rooms.is_empty() {
        "no room there".into()
    } else {
        format!("in pieces: {}", pieces())
    }
}

/// The comparison as lines of text.
pub fn text(truth: &Truth, score: &Score, all_doors: bool) -> String {
    let mut out = String::new();
    let mut line = |l: String| {
        let _ = writeln!(out, "{l}");
    };
    let widest = truth.spaces.iter().map(|s| s.name.chars().count()).max().unwrap_or(0).max(5);
    line(format!("{:<widest$} {:>9} {:>6} {:>8}  ", "space", "floor m2", "room", "overlap"));
    for (i, (space, s)) in truth.spaces.iter().zip(&score.spaces).enumerate() {
        let room = s.room.map_or("-".into(), |r| r.to_string());
        let mut words =
            if space.outdoors { "not indoors, not counted".into() } else { verdict(score, i) };
        if !space.outdoors && !s.counts {
            let _ = write!(words, " (below {LEAST_AREA} m2, not counted)");
        }
        line(format!(
            "{:<widest$} {:>9.2} {room:>6} {:>8.2}  {words}",
            space.name, space.area, s.overlap
        ));
    }
    for m in &score.merged {
        let names: Vec<&str> = m.spaces.iter().map(|&s| truth.spaces[s].name.as_str()).collect();
        line(format!("\nroom {} covers {}", m.room, names.join(" + ")));
        for &(a, b, between) in &m.pairs {
            let what = match between {
                Between::Nothing => "nothing divides",
                Between::Door => "a door divides",
                Between::Wall => "a wall divides",
                Between::Unknown => "only boxes are known of",
            };
            line(format!("  {what} {} and {}", truth.spaces[a].name, truth.spaces[b].name));
        }
    }
    line(format!(
        "\n{:<40} {:>9} {:>9} {:>7}  between",
        "door or window", "side", "side", "open m2"
    ));
    for (door, s) in truth.doors.iter().zip(&score.doors) {
        if s.found && !all_doors {
            continue;
        }
        let names: Vec<&str> = door
            .spaces
            .iter()
            .map(|s| s.map_or("outside", |s| truth.spaces[s].name.as_str()))
            .collect();
        let short: String = door.name.chars().take(40).collect();
        line(format!(
            "{short:<40} {:>9} {:>9} {:>7.2}  {}{}",
            place(s.sides[0]),
            place(s.sides[1]),
            s.opening,
            names.join(" | "),
            if s.found { "" } else { ": NOT FOUND" }
        ));
    }
    line(format!("\n{}:", truth.model));
    line(format!("  spaces above {LEAST_AREA} m2, one to one   {}", share(score.matched())));
    line(format!("  of those that walls divide      {}", share(score.matched_of_divided())));
    line(format!("  door connections, inside        {}", share(score.doors(truth, false))));
    line(format!("  doors and windows to outside    {}", share(score.doors(truth, true))));
    out
}

/// The comparison as JSON.
pub fn json(truth: &Truth, score: &Score) -> Value {
    let part = |s: Share| json!({"good": s.good, "all": s.all, "percent": s.percent()});
    json!({
        "model": truth.model,
        "spaces": truth.spaces.iter().zip(&score.spaces).enumerate().map(|(i, (space, s))| json!({
            "name": space.name, "area_m2": space.area, "room": s.room, "overlap": s.overlap,
            "counted": s.counts, "outside": s.outside, "verdict": verdict(score, i),
            "rooms": s.rooms.iter().map(|r| json!({"room": r.0, "share": r.1})).collect::<Vec<_>>(),
        })).collect::<Vec<_>>(),
        "merged": score.merged.iter().map(|m| json!({
            "room": m.room,
            "spaces": m.spaces.iter().map(|&s| &truth.spaces[s].name).collect::<Vec<_>>(),
            "open": m.pairs.iter().filter(|p| p.2 == Between::Nothing)
                .map(|p| [&truth.spaces[p.0].name, &truth.spaces[p.1].name]).collect::<Vec<_>>(),
        })).collect::<Vec<_>>(),
        "doors": truth.doors.iter().zip(&score.doors).map(|(d, s)| json!({
            "name": d.name, "exterior": d.exterior, "found": s.found, "open_m2": s.opening,
            "sides": s.sides.map(place),
        })).collect::<Vec<_>>(),
        "matched": part(score.matched()),
        "matched_of_divided": part(score.matched_of_divided()),
        "doors_inside": part(score.doors(truth, false)),
        "doors_outside": part(score.doors(truth, true)),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::score::{DoorScore, SpaceScore};
    use crate::truth::{Door, Shape, Space};
    use glam::DVec3;

    #[test]
    fn the_table_names_what_is_missing() {
        let truth = Truth {
            model: "m".into(),
            spaces: vec![Space {
                name: "A1 Hall".into(),
                min: DVec3::ZERO,
                max: DVec3::ONE,
                area: 20.0,
                shape: Shape::Box,
                outdoors: false,
            }],
            doors: vec![Door {
                name: "D1".into(),
                centre: DVec3::ZERO,
                normal: DVec3::X,
                thickness: 0.1,
                width: 1.0,
                door: true,
                exterior: false,
                spaces: [Some(0), None],
            }],
        };
        let score = Score {
            spaces: vec![SpaceScore {
                room: None,
                overlap: 0.3,
                rooms: vec![(4, 0.3)],
                outside: 0.7,
                counts: true,
            }],
            merged: vec![],
            doors: vec![DoorScore {
                sides: [Place::Room(4), Place::Outside],
                found: false,
                opening: 0.0,
            }],
        };
        let text = text(&truth, &score, false);
        assert!(text.contains("A1 Hall") && text.contains("70 % of it is outside"), "{text}");
        assert!(text.contains("A1 Hall | outside: NOT FOUND"), "{text}");
        assert!(text.contains("0 of 1 (0.0 %)"), "{text}");
        assert_eq!(json(&truth, &score)["doors_inside"]["good"], 0);
    }
}

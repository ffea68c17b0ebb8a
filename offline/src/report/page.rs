//! The page around the sections: style, figures, legends, numbers with uncertainty, provenance.

use super::ReportInput;
use crate::demo::{Demo, Observations, SceneKind};
use crate::effects;
use crate::plot::{Colour, FAINT, Panel, svg};
use maud::{DOCTYPE, Markup, PreEscaped, html};

/// Colour of the base model.
pub(super) const BASE: Colour = (213, 94, 0);
/// Colour of the final model.
pub(super) const FINAL: Colour = (0, 90, 170);
/// Colour of measured points.
pub(super) const MEASURED: Colour = (165, 165, 165);
/// Colour of the noise floor.
pub(super) const NOISE: Colour = FAINT;

const STYLE: &str = "
:root{color-scheme:light}
body{margin:0 auto;padding:24px 28px 60px;max-width:1080px;background:#fff;color:#222;
 font:15px/1.5 system-ui,-apple-system,'Segoe UI',sans-serif}
h1{font-size:26px;margin:0 0 4px}
h2{font-size:20px;margin:44px 0 8px;padding-top:14px;border-top:1px solid #ddd}
h3{font-size:16px;margin:24px 0 6px}
p{max-width:78ch;margin:8px 0}
.answer{border-left:5px solid #888;background:#f6f7f9;padding:12px 18px;margin:14px 0 20px}
.answer p{margin:4px 0;max-width:none}
.answer .verdict{font-size:18px;font-weight:600}
.good{border-color:#2a8a4a}.warn{border-color:#d08a00}.bad{border-color:#b8322a}
table{border-collapse:collapse;margin:10px 0;font-variant-numeric:tabular-nums}
th,td{text-align:left;padding:4px 14px 4px 0;border-bottom:1px solid #e4e4e4;vertical-align:top}
th{font-weight:600;border-bottom:1px solid #999;white-space:nowrap}
th.row{border-bottom-color:#e4e4e4}
.nowrap,td.n,th.n{text-align:right;white-space:nowrap}
tr.best td{background:#eef6ef}
.scroll{overflow-x:auto}
.quiet{color:#6a6a6a}
.yes{color:#1f7a3d;font-weight:600}.no{color:#b8322a;font-weight:600}
ul{margin:6px 0;padding-left:22px}
figure{margin:14px 0}
figcaption{color:#444;font-size:14px;max-width:90ch}
.grid{display:grid;gap:4px}.three{grid-template-columns:repeat(3,1fr)}.two{grid-template-columns:repeat(2,1fr)}
svg{max-width:100%;height:auto;display:block}
.key{display:inline-block;width:18px;height:4px;border-radius:2px;margin:0 5px 3px 14px}
.dot{display:inline-block;width:8px;height:8px;border-radius:50%;margin:0 5px 0 14px}
pre{background:#f6f7f9;padding:10px 14px;overflow-x:auto;font-size:13px}
@media print{h2{break-after:avoid}figure,table{break-inside:avoid}}
";

/// A whole page.
pub(super) fn page(title: &str, body: &Markup) -> String {
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { (title) }
                style { (PreEscaped(STYLE)) }
            }
            body { h1 { (title) } (body) }
        }
    }
    .into_string()
}

/// A panel as SVG inside HTML, where the namespace goes without saying.
pub(super) fn figure_svg(panel: &Panel) -> Markup {
    let text = svg(std::slice::from_ref(panel));
    PreEscaped(text.replace(" xmlns=\"http://www.w3.org/2000/svg\"", ""))
}

/// A colour as CSS and SVG write it.
pub(super) fn hex((red, green, blue): Colour) -> String {
    format!("#{red:02x}{green:02x}{blue:02x}")
}

/// A line of a legend.
pub(super) fn key(colour: Colour, text: &str) -> Markup {
    html! { span.key style=(format!("background:{}", hex(colour))) {} (text) }
}

/// A dot of a legend.
pub(super) fn dot(colour: Colour, text: &str) -> Markup {
    html! { span.dot style=(format!("background:{}", hex(colour))) {} (text) }
}

/// Words as a sentence of its own.
pub(super) fn sentence(words: &str) -> String {
    let mut letters = words.chars();
    let first = letters.next().map(|c| c.to_uppercase().to_string());
    format!("{}{}.", first.unwrap_or_default(), letters.as_str())
}

/// An effect's name for people.
pub(super) fn effect_title(id: &str) -> &str {
    effects::find(id).map_or(id, |index| effects::ALL[index].title)
}

/// A parameter's name within its effect without the unit at its end, which stands by the value. What has the unit "1"
/// has none in its name: the second of a share of one second is not a unit of the share.
pub(super) fn without_unit(parameter: &str, unit: &str) -> String {
    let units = [
        "_rad_per_n_m",
        "_m2_s2",
        "_per_m2",
        "_per_m",
        "_per_s",
        "_kg",
        "_rad",
        "_s",
        "_m",
        "_pa",
    ];
    let bare = units
        .iter()
        .filter(|_| unit != "1")
        .find_map(|unit| parameter.strip_suffix(unit));
    bare.unwrap_or(parameter).replace('_', " ")
}

/// The name of a parameter of this unit, for people.
pub(super) fn parameter_title(name: &str, unit: &str) -> String {
    match (name, name.split_once('.')) {
        ("young_pa", _) => "Young’s modulus E".to_owned(),
        ("poisson", _) => "Poisson’s ratio ν".to_owned(),
        (_, Some((effect, parameter))) => {
            format!("{}: {}", effect_title(effect), without_unit(parameter, unit))
        }
        _ => name.to_owned(),
    }
}

/// Where the figures come from.
pub(super) fn provenance(input: &ReportInput) -> Markup {
    let noise = input.outcome.noise.in_words();
    html! {
        h2 { "Provenance" }
        table {
            @for (what, value) in input.provenance { tr { th.row { (what) } td { (value) } } }
            tr { th.row { "noise of the points" } td { (noise) } }
        }
        table {
            tr { th { "demonstration" } th { "role" } th { "scene" } th.n { "instants" } th.n { "points" } th { "notes" } }
            @for demo in input.demos { (demo_row(demo, "fitted")) }
            @for demo in input.held_out { (demo_row(demo, "held out")) }
        }
    }
}

fn demo_row(demo: &Demo, role: &str) -> Markup {
    let scene = match demo.spec.scene {
        SceneKind::Lift => "lift",
        SceneKind::Swing => "swing",
        SceneKind::Free => "free",
        SceneKind::Static => "static poses",
    };
    let (instants, points) = match &demo.observations {
        Observations::Clouds(frames) => (frames.len(), frames.iter().map(|f| f.points_m.len()).sum()),
        Observations::Markers(samples) => (samples.chunk_by(|a, b| a.t_s == b.t_s).count(), samples.len()),
    };
    html! {
        tr {
            td { (demo.name) } td { (role) } td { (scene) }
            td.n { (instants) } td.n { (points) } td.quiet { (demo.spec.notes) }
        }
    }
}

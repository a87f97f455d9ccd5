//! The page: one HTML file that needs nothing else, on a screen of any size and theme, on paper and for a screen reader.
//!
//! Maud escapes every text. There is no script; links go to the page itself or to data inside it.

use crate::figure::{Entry, Figure, Svg, swatch};
use crate::table::Table;
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use maud::{DOCTYPE, Markup, PreEscaped, html};

/// Rows of the figures' tables inside the page, shared by its sequences; longer tables are thinned, the files keep
/// every row.
const MOST_ROWS: usize = 3000;

/// How far a drawing is stretched on a wide screen: hardly, so that letters are of one size in all figures.
const LARGEST: f64 = 1.1;

/// What a page shows.
pub struct Page<'a> {
    /// Headline.
    pub title: &'a str,
    /// One line below it.
    pub lead: String,
    /// The result in words.
    pub verdict: Vec<String>,
    /// Tables over all sequences.
    pub overall: Vec<Table>,
    /// Sequence by sequence.
    pub sections: Vec<Section>,
    /// Name and value of what made this report.
    pub origin: Vec<(String, String)>,
}

/// One sequence on the page.
pub struct Section {
    /// Its name.
    pub name: String,
    /// The result in words.
    pub verdict: Vec<String>,
    /// What the reader must know.
    pub notes: Vec<String>,
    /// Its tables.
    pub tables: Vec<Table>,
    /// Its figures.
    pub figures: Vec<Figure>,
}

impl Page<'_> {
    /// The whole document.
    pub fn html(&self) -> String {
        let page = html! {
            (DOCTYPE)
            html lang="en" {
                head {
                    meta charset="utf-8";
                    meta name="viewport" content="width=device-width, initial-scale=1";
                    meta name="color-scheme" content="light dark";
                    title { (self.title) }
                    style { (PreEscaped(include_str!("page.css"))) }
                }
                body {
                    a.skip href="#content" { "Skip to the result" }
                    header {
                        h1 { (self.title) }
                        p.lead { (self.lead) }
                        (self.contents())
                    }
                    main id="content" {
                        (verdict(&self.verdict))
                        @for table in &self.overall { (table.html()) }
                        @for (index, section) in self.sections.iter().enumerate() { (section.html(index, MOST_ROWS / self.sections.len().max(1))) }
                        (definitions())
                    }
                    footer { (self.footer()) }
                }
            }
        };
        page.into_string()
    }

    fn contents(&self) -> Markup {
        html! {
            nav aria-label="Contents" {
                ul {
                    @for (index, section) in self.sections.iter().enumerate() {
                        li { a href={ "#" (section_id(index)) } { (section.name) } }
                        @for figure in &section.figures { li { a href={ "#" (figure.id) } { (figure.title) } } }
                    }
                    li { a href="#definitions" { "Definitions" } }
                }
            }
        }
    }

    fn footer(&self) -> Markup {
        html! {
            dl { @for (name, value) in &self.origin { dt { (name) } dd { (value) } } }
        }
    }
}

fn section_id(index: usize) -> String {
    format!("sequence-{}", index + 1)
}

fn verdict(sentences: &[String]) -> Markup {
    html! {
        @if !sentences.is_empty() {
            section.verdict aria-label="The result in words" {
                ul { @for sentence in sentences { li { (sentence) } } }
            }
        }
    }
}

impl Section {
    fn html(&self, index: usize, rows: usize) -> Markup {
        html! {
            section id=(section_id(index)) aria-labelledby={ (section_id(index)) "-title" } {
                h2 id={ (section_id(index)) "-title" } { (self.name) }
                (verdict(&self.verdict))
                @if !self.notes.is_empty() {
                    ul.notes { @for note in &self.notes { li { (note) } } }
                }
                @for table in &self.tables { (table.html()) }
                @for figure in &self.figures { (figure_html(figure, rows)) }
            }
        }
    }
}

fn figure_html(figure: &Figure, rows: usize) -> Markup {
    let caption = format!("{}-caption", figure.id);
    let layout = if figure.panels.len() == 1 && figure.legend.is_empty() { "wide" } else { "panels" };
    html! {
        figure id=(figure.id) aria-labelledby=(caption) {
            h3 { (figure.title) }
            @if !figure.legend.is_empty() {
                ul.legend { @for entry in &figure.legend { li { (legend_swatch(entry)) (entry.name) } } }
            }
            @if layout == "wide" {
                div.wide tabindex="0" role="group" aria-label=(figure.title) { @for panel in &figure.panels { (inline(panel)) } }
            } @else {
                div.panels { @for panel in &figure.panels { (inline(panel)) } }
            }
            figcaption id=(caption) { (figure.caption) " " (download(figure, rows)) }
        }
    }
}

/// A drawing inside the page, in the colours of its theme.
fn inline(panel: &Svg) -> Markup {
    html! {
        svg xmlns="http://www.w3.org/2000/svg" viewBox={ "0 0 " (panel.width) " " (panel.height) } role="img" aria-label=(panel.label)
            style={ "max-width:" (format!("{:.0}", LARGEST * panel.width)) "px" } {
            (PreEscaped(&panel.body))
        }
    }
}

fn legend_swatch(entry: &Entry) -> Markup {
    html! {
        svg width="30" height="12" viewBox="0 0 30 12" aria-hidden="true" { (PreEscaped(swatch(entry, (0.0, 6.0)))) }
    }
}

/// The numbers of a figure as a file inside the page.
fn download(figure: &Figure, most_rows: usize) -> Markup {
    if figure.csv.is_empty() {
        return html! {};
    }
    let (csv, step) = thinned(&figure.csv, most_rows);
    let note =
        if step > 1 { format!(" (every {step}th row; the file beside this page has all)") } else { String::new() };
    html! {
        a.download href={ "data:text/csv;base64," (STANDARD.encode(csv)) } download={ (figure.id) ".csv" } {
            "Download CSV" span.hidden { " of " (figure.title) }
        }
        (note)
    }
}

/// Head and every n-th row, and that n.
fn thinned(csv: &str, most_rows: usize) -> (String, usize) {
    let rows = csv.lines().count().saturating_sub(1);
    let step = rows.div_ceil(most_rows.max(1)).max(1);
    let kept = csv.lines().enumerate().filter(|(index, _)| *index == 0 || (index - 1) % step == 0);
    (kept.map(|(_, line)| format!("{line}\n")).collect(), step)
}

fn definitions() -> Markup {
    html! {
        section id="definitions" aria-labelledby="definitions-title" {
            h2 id="definitions-title" { "Definitions" }
            dl {
                dt { "ATE" } dd { "Distance of each estimated position from the true one after the alignment that is named." }
                dt { "RPE" } dd { "Error of the motion between two poses a fixed distance apart." }
                dt { "Drift" } dd { "Error at the end of sub-trajectories, as a share of their length; mean over all of them, as the KITTI benchmark has it." }
                dt { "Completeness" } dd { "Share of the true path the method answered. Errors hold for that part alone." }
                dt { "Zero, constant, previous motion" } dd { "Answers that look at no picture: standing still, one mean motion for ever, the true motion of the frame before. A result is worth something where it beats them." }
                dt { "Windows" } dd { "Short windows, each scaled on its own; \u{201c}published\u{201d} is the figure papers print, smaller than the root mean square by the root of the length. It cannot see a path written backwards." }
                dt { "AbsRel, RMSE log, d < 1.25" } dd { "Relative error of depth, error of its logarithm, and share of pixels within a factor of 1.25." }
                dt { "Beyond chance" } dd { "Within one sequence: the 95 % interval of the mean difference, drawn in blocks of a twentieth of the path, leaves out zero. Across sequences: the two-sided signed-rank test of Wilcoxon." }
            }
        }
    }
}

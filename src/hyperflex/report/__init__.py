"""Pictures, films and pages of results."""

from typing import TYPE_CHECKING

from hyperflex.lazy import attach

if TYPE_CHECKING:
    from hyperflex.report.cast import CastReport
    from hyperflex.report.curves import recording_figure, run_figure, sideways_figure
    from hyperflex.report.drives import cast_run_figure, drive_figure, learning_figure
    from hyperflex.report.folder import Progress, check_folder, silent, whole_folder
    from hyperflex.report.identification.figures import FittedChannels, fit_figure
    from hyperflex.report.identification.page import identification_page, write_found, write_identification
    from hyperflex.report.identification.tables import parameters_table, predicted, ratios_table
    from hyperflex.report.maps import reach_figure, vibration_figure
    from hyperflex.report.notebook import identification_html, plan_figure, plan_html, rope_html, run_html
    from hyperflex.report.page import (
        Film,
        Picture,
        Section,
        TextTable,
        render,
        sections_markdown,
        write_page,
        write_pictures,
    )
    from hyperflex.report.pictures import animate, strobe_figure
    from hyperflex.report.plan import PlanReport
    from hyperflex.report.player import FRAME_RATE, player_html, write_player
    from hyperflex.report.scene import Dots, Line, Overlay, Plot
    from hyperflex.report.style import (
        BLUE,
        GREEN,
        GREY,
        INK,
        OUTCOME_COLOUR,
        RED,
        Figure,
        legend,
        new_figure,
        png,
        save_png,
    )
    from hyperflex.report.tip import InsertReport, WhipReport
    from hyperflex.report.units import readable_unit

__getattr__, __dir__, __all__ = attach(__name__, __file__)

from .animation import animate as animate
from .charts import draw_sweep as draw_sweep
from .drawing import draw as draw
from .explore import explore as explore, Explorer as Explorer
from .fits import draw_fit as draw_fit
from .frequency_plots import draw_frequency_response as draw_frequency_response
from .hinge_plots import draw_energy as draw_energy
from .oblique import draw_out_of_plane as draw_out_of_plane
from .optimum_plots import draw_optimum as draw_optimum
from .path_plots import draw_path as draw_path
from .port_plots import (
    draw_port_motion as draw_port_motion,
    draw_stiffness as draw_stiffness,
)
from .stress_plots import draw_fatigue as draw_fatigue
from .wave_plots import draw_dispersion as draw_dispersion

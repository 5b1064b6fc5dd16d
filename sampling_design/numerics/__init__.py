"""Linear algebra, exponentials, ball arithmetic and conic programs: numerics that know neither plants nor schedules."""

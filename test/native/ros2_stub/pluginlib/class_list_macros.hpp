#define PLUGINLIB_EXPORT_CLASS(plugin, base) static_assert(sizeof(plugin) > sizeof(base));

#pragma once
#define PLUGINLIB_EXPORT_CLASS(derived, base) static_assert(sizeof(derived) > 0 && sizeof(base) > 0, "a plugin");

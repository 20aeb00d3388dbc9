# Builds a part of an interface package that the ROS wheels lack. A ROS distribution has its own.
find_package(ament_cmake REQUIRED)
find_package(rosidl_default_generators REQUIRED)

# The wheels have no client library for C++.
list(FILTER AMENT_EXTENSIONS_rosidl_generate_idl_interfaces EXCLUDE REGEX "_cpp:")

# interfaces(FILE ... DEPENDENCIES PACKAGE ...), and the end of the package.
macro(interfaces)
  cmake_parse_arguments(_i "" "" "DEPENDENCIES" ${ARGN})
  foreach(package ${_i_DEPENDENCIES})
    find_package(${package} REQUIRED)
  endforeach()
  rosidl_generate_interfaces(${PROJECT_NAME} ${ARGN})
  ament_export_dependencies(rosidl_default_runtime)
  ament_package()
endmacro()
